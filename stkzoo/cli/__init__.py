"""The command line, ``stkzoo``: each public module of this package is one command.

The module of a command has

- a docstring, whose first line is the command's summary in ``stkzoo --help``. The rest is its
  description in ``stkzoo COMMAND --help``, which shows the part from ``exit codes:`` at the end;
- ``add_arguments(parser)``, which declares its arguments;
- ``run(arguments)``, which runs the command and returns the exit code. A command with actions has
  one function for each action instead (:func:`~stkzoo.cli._arguments.add_actions`).

Modules must be fast to import, so slow imports are inside ``add_arguments`` and ``run``. The
module ``race_server`` is the command ``race-server``. Private modules contain shared code.
"""

from __future__ import annotations

import io
import pkgutil
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version

from stkzoo._arguments import CommandParser
from stkzoo._schema import plain_text
from stkzoo.cli._arguments import INTERRUPTED, add_command
from stkzoo.cli._process import EndSignals, discard_stdout, writing_stdout
from stkzoo.errors import StkzooError

__all__ = ["COMMANDS", "build_parser", "main"]

#: Names of the commands.
COMMANDS = tuple(
    module.name.replace("_", "-")
    for module in pkgutil.iter_modules(__path__)
    if not module.name.startswith("_")
)

_EPILOG = """\
first steps:
  stkzoo doctor             check this machine and suggest fixes
  stkzoo assets install     get the game's tracks and karts
  stkzoo race --demo        a race: a learned driver against the hardest bots
  stkzoo new my_agent       create an agent of your own
  stkzoo race my_agent ai   race it against the game's AI
  stkzoo check my_agent     see whether a tournament would accept it

`stkzoo COMMAND --help` has examples of each.

exit codes:
  0 success, 1 failure, 2 invalid command line, 3 an agent failed,
  130 interrupted (by SIGTERM: 143, by SIGHUP: 129)
"""


def build_parser(command: str | None = None) -> CommandParser:
    """Returns the parser of the command line.

    Args:
        command: the command to parse. Other commands are listed without their arguments. ``None``
            declares the arguments of all commands.
    """
    parser = CommandParser(
        prog="stkzoo",
        description="Multi-agent kart racing on the real SuperTuxKart engine.",
        epilog=_EPILOG,
    )
    parser.add_argument("--version", action="version", version=f"stkzoo {version('stkzoo')}")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in COMMANDS:
        module = import_module(f"{__name__}.{name.replace('-', '_')}")
        options = getattr(module, "PARSER_OPTIONS", {})
        child = add_command(subparsers, name, module, **options)
        if command in (None, name):
            module.add_arguments(child)
            child.set_defaults(run=getattr(module, "run", None), fail=child.fail)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        argv: arguments after the name of the program; ``None`` for those of this process.

    Returns:
        The exit code: 0 for success; 1 for failure, or if the reader of stdout has ended, as with
        ``| head``; 2 for an invalid command line; 130 after an interrupt from the keyboard, 143
        after SIGTERM and 129 after SIGHUP. Some commands return further codes.
    """
    words = sys.argv[1:] if argv is None else list(argv)
    if isinstance(sys.stdout, io.TextIOWrapper):  # let it print any text
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        with EndSignals() as signals:
            return signals.exit_code(_run(words))
    except BrokenPipeError:
        discard_stdout()
        return 1


def _run(words: list[str]) -> int:
    try:
        with writing_stdout():
            return _exit_code(words)
    except StkzooError as error:
        print(f"stkzoo: {plain_text(str(error))}", file=sys.stderr)  # it may name strange files
        return 1
    except KeyboardInterrupt:
        print("stkzoo: interrupted", file=sys.stderr)
        return INTERRUPTED


def _exit_code(words: list[str]) -> int:
    try:
        arguments = build_parser(words[0] if words else "").parse_args(words or ["--help"])
        return int(arguments.run(arguments))
    except SystemExit as end:  # argparse: 0 after --help, 2 after bad usage
        return end.code if isinstance(end.code, int) else 1
