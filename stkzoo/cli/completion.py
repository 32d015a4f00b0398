"""Print a completion script for your shell.

Prints a script with which a shell completes commands, options and their choices. It contains
nothing specific to this machine; print it again after an update.

Examples:
  stkzoo completion bash > ~/.local/share/bash-completion/completions/stkzoo
  stkzoo completion zsh > ~/.zfunc/_stkzoo       a folder of $fpath
  stkzoo completion fish > ~/.config/fish/completions/stkzoo.fish
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

from stkzoo._arguments import positional
from stkzoo._imports import import_extra

#: The shells that shtab supports.
_SHELLS = ("bash", "zsh", "fish", "tcsh")


@dataclass
class CompletionArguments:
    """Options of ``stkzoo completion``.

    Attributes:
        shell: bash, zsh, fish or tcsh
    """

    shell: str = positional(choices=_SHELLS, metavar="SHELL")


def run(arguments: CompletionArguments) -> None:
    """Prints the completion script."""
    from stkzoo.cli import build_parser

    shtab = import_extra("shtab", "completion needs", "races")
    parser = build_parser()
    _complete_files(parser, shtab.FILE)
    print(shtab.complete(parser, shell=arguments.shell))


def _complete_files(parser: argparse.ArgumentParser, files: Any) -> None:
    """Marks arguments whose metavar shows that they are files or folders."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for child in action.choices.values():
                _complete_files(child, files)
        elif action.metavar in ("FILE", "FOLDER", "PATH", "RESULT", "DRIVER", "AGENT"):
            action.complete = files  # type: ignore[attr-defined]
