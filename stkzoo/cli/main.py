"""The command ``stkzoo``: one module of this package per subcommand."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version

from stkzoo.errors import StkzooError

__all__ = ["COMMANDS", "build_parser", "main"]

#: The subcommands in the order of the help. Each is a module ``stkzoo.cli.<name>``
#: with ``add_parser(subparsers)``, which sets ``run``: a function of the parsed
#: arguments that returns the exit code. It is light to import: what is heavy is
#: imported when it runs.
COMMANDS = (
    "race",
    "play",
    "replay",
    "tournament",
    "benchmark",
    "demos",
    "league",
    "race-server",
    "race-client",
    "keys",
    "tracks",
    "karts",
    "assets",
    "doctor",
    "completion",
)

_EPILOG = """\
first steps:
  stkzoo doctor             what works on this machine, and what mends the rest
  stkzoo assets install     get the game's tracks and karts
  stkzoo race --demo        a race: a learned driver against the hardest bots
  stkzoo race my_agent/ ai  your agent against the game's AI

`stkzoo COMMAND --help` has examples of each.

exit codes:
  0 all is well, 1 it failed, 2 the command cannot be understood,
  3 the race ran but an agent failed, 130 interrupted
"""


def build_parser() -> argparse.ArgumentParser:
    """The whole command line's parser."""
    parser = argparse.ArgumentParser(
        prog="stkzoo",
        description="Multi-agent kart racing on the real SuperTuxKart engine.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"stkzoo {version('stkzoo')}")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in COMMANDS:
        import_module(f"stkzoo.cli.{name.replace('-', '_')}").add_parser(subparsers)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        argv: the words after the program's name; ``None`` for the process's own.

    Returns:
        0 if all went well, 1 if it failed, 2 for a command that cannot be understood,
        130 after an interrupt from the keyboard.
    """
    try:
        arguments = build_parser().parse_args(argv)
        return int(arguments.run(arguments))
    except SystemExit as end:  # argparse: 0 after --help, 2 after bad usage
        return end.code if isinstance(end.code, int) else 1
    except StkzooError as error:
        print(f"stkzoo: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stkzoo: interrupted", file=sys.stderr)
        return 130
