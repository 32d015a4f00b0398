"""The command line, ``stkzoo``: each public module of this package is one command.

The module of a command has

- a docstring, whose first line is the command's summary in ``stkzoo --help``. The rest is its
  description in ``stkzoo COMMAND --help``, which shows the part from ``exit codes:`` at the end;
- ``run(arguments)``, which runs the command and returns the exit code, or ``None`` for 0. The
  annotation of ``arguments`` is a dataclass, whose fields are the command's options
  (:mod:`stkzoo._arguments`). A ``ConfigError`` is reported as an invalid command line;
- or, instead of ``run``, ``ACTIONS``: such a function for each action of the command, such as
  ``install`` of ``stkzoo assets install``, with the action's name and docstring. A command with
  options before the action also has ``add_arguments(parser)``, and one whose options have other
  defaults than their dataclasses has ``DEFAULTS``.

Only the module of the command that runs is imported. The module ``race_server`` is the command
``race-server``. Private modules contain shared code.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import pkgutil
import sys
import types
import typing
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.metadata import version

from stkzoo._arguments import CommandParser, add_options, values_of
from stkzoo._installation import project_url
from stkzoo._os import sentence_of
from stkzoo._schema import plain_text
from stkzoo.cli._process import INTERRUPTED, discard_stdout, end_signals, writing_stdout
from stkzoo.errors import ConfigError, StkzooError

__all__ = ["COMMANDS", "build_parser", "main"]
__dir__ = __all__.copy

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

`stkzoo COMMAND --help` has examples of each. The documentation is at {url}

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
        epilog=_EPILOG.format(url=project_url("Documentation")),
    )
    parser.add_argument("--version", action="version", version=f"stkzoo {version('stkzoo')}")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in COMMANDS:
        module = name.replace("-", "_")
        if command in (None, name):
            _add_command(subparsers, name, import_module(f"{__name__}.{module}"))
        else:
            source = ast.parse(pkgutil.get_data(__name__, f"{module}.py") or b"")
            subparsers.add_parser(name, help=_summary(ast.get_docstring(source) or ""))
    return parser


def _add_command(
    subparsers: argparse._SubParsersAction[CommandParser],
    name: str,
    command: typing.Any,
    defaults: Mapping[str, typing.Any] = types.MappingProxyType({}),
) -> None:
    """Adds the parser of a command or an action.

    Args:
        subparsers: subparsers of the command line or of a command.
        name: name of the command or action.
        command: module of the command, or function of the action. The help shows the exit codes in
            its docstring below the options.
        defaults: defaults of the action's options that the module of its command sets.
    """
    documentation = inspect.getdoc(command) or ""
    description, heading, codes = documentation.partition("\n\n")[2].partition("exit codes:")
    parser = subparsers.add_parser(
        name,
        help=_summary(documentation),
        description=description.rstrip().replace("Examples:\n", "examples:\n")
        or documentation.strip(),
        epilog=heading + codes,
        **getattr(command, "PARSER_OPTIONS", {}),
    )
    if hasattr(command, "add_arguments"):
        command.add_arguments(parser)
    if actions := getattr(command, "ACTIONS", ()):
        children = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
        for action in actions:
            word = action.__name__.strip("_").replace("_", "-")
            _add_command(children, word, action, getattr(command, "DEFAULTS", {}))
        return
    run = getattr(command, "run", command)
    owner = typing.get_type_hints(run)["arguments"]
    add_options(parser, owner, defaults=defaults)

    def run_parsed(values: argparse.Namespace) -> int:
        try:
            return int(run(owner(**values_of(values, owner))) or 0)
        except ConfigError as error:
            parser.fail(plain_text(str(error)))  # it may name strange files

    parser.set_defaults(run=run_parsed)


def _summary(documentation: str) -> str:
    """Returns the first line of a docstring as an entry of a list of commands."""
    line = documentation.partition("\n")[0]
    return line[:1].lower() + line[1:].rstrip(".")


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
    try:
        with end_signals() as came:
            code = _run(words)
            return 128 + came[0] if came and code == INTERRUPTED else code
    except BrokenPipeError:
        discard_stdout()
        return 1


def _run(words: list[str]) -> int:
    try:
        with writing_stdout():
            return _exit_code(words)
    except (StkzooError, OSError) as error:
        print(f"stkzoo: {sentence_of(error)}", file=sys.stderr)
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
