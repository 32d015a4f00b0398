"""``stkzoo completion``: commands and options, completed by the shell."""

from __future__ import annotations

import argparse
from typing import Any

from stkzoo.errors import ConfigError

__all__ = ["add_parser"]

_ABOUT = """\
Writes a script that lets a shell complete commands, options and their choices. It names nothing
of this machine, and may be written anew after an update.
"""

_EXAMPLES = """\
examples:
  stkzoo completion bash > ~/.local/share/bash-completion/completions/stkzoo
  stkzoo completion zsh > ~/.zfunc/_stkzoo       a folder of $fpath
  stkzoo completion fish > ~/.config/fish/completions/stkzoo.fish
"""

#: The shells that shtab writes for.
_SHELLS = ("bash", "zsh", "fish", "tcsh")


def add_parser(subparsers: argparse._SubParsersAction[Any]) -> None:
    """Adds the command."""
    parser = subparsers.add_parser(
        "completion",
        help="completion of commands and options in your shell",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("shell", choices=_SHELLS, help="whose script to write")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    from stkzoo.cli.main import build_parser

    try:
        import shtab
    except ImportError:
        raise ConfigError(
            "completion needs shtab, which is not installed; run `pip install 'stkzoo[completion]'`"
        ) from None
    parser = build_parser()
    _complete_files(parser, shtab.FILE)
    print(shtab.complete(parser, shell=arguments.shell))
    return 0


def _complete_files(parser: argparse.ArgumentParser, files: Any) -> None:
    """Marks what is a file or folder, by what its option is called."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for child in action.choices.values():
                _complete_files(child, files)
        elif action.metavar in ("FILE", "FOLDER", "DIR", "DRIVER", "AGENT", "REPLAY"):
            action.complete = files  # type: ignore[attr-defined]
