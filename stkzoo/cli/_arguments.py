"""Arguments that several commands share, and functions to add commands."""

from __future__ import annotations

import argparse
import functools
import inspect
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

from stkzoo._arguments import CommandParser, add_options, option
from stkzoo._schema import plain_text
from stkzoo.errors import ConfigError
from stkzoo.race import RaceSettings

#: Values of ``reverse`` by the names of ``--directions``.
DIRECTIONS = {"forward": False, "reversed": True}

#: Exit codes when an agent failed and after Ctrl-C.
AGENT_FAILED, INTERRUPTED = 3, 130

Run = Callable[[argparse.Namespace], int]


def usage_errors(run: Run) -> Run:
    """Decorator that reports a command's ``ConfigError`` like argparse, with exit code 2.

    Args:
        run: the command's ``run``.
    """

    @functools.wraps(run)
    def checked(arguments: argparse.Namespace) -> int:
        try:
            return run(arguments)
        except ConfigError as error:
            arguments.fail(plain_text(str(error)))  # it may name strange files
            raise  # not reached: fail() exits

    return checked


def add_command(
    subparsers: argparse._SubParsersAction[CommandParser],
    name: str,
    documented: object,
    **options: Any,
) -> CommandParser:
    """Adds the parser of a command or an action.

    Args:
        subparsers: subparsers of the command line or of a command.
        name: name of the command or action.
        documented: module or function with its docstring: a summary, and optionally a description,
            "Examples:" and "exit codes:". The help shows the exit codes below the options.
        **options: further arguments of the parser.
    """
    summary, _, text = (inspect.getdoc(documented) or "").partition("\n\n")
    description, heading, codes = text.partition("exit codes:")
    return subparsers.add_parser(
        name,
        help=summary[:1].lower() + summary[1:].rstrip("."),
        description=description.rstrip().replace("Examples:\n", "examples:\n") or summary,
        epilog=heading + codes,
        **options,
    )


def add_actions(parser: CommandParser, *actions: Run) -> list[CommandParser]:
    """Adds the actions of a command, such as ``install`` of ``stkzoo assets install``.

    Args:
        parser: parser of the command.
        *actions: functions named after the actions. Each is called like a command's ``run``.

    Returns:
        The parsers of the actions.
    """
    subparsers = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    children = []
    for action in actions:
        child = add_command(subparsers, action.__name__.strip("_").replace("_", "-"), action)
        child.set_defaults(run=action, fail=child.fail)
        children.append(child)
    return children


@dataclass
class BatchArguments:
    """Options of all commands that run many races.

    Attributes:
        jobs: races at the same time (default: all CPU cores)
        race_timeout: time limit of one race; a longer race is repeated with a time budget for
            each agent
    """

    jobs: int | None = None
    race_timeout: float = option(3600.0, metavar="SECONDS")


def add_batch_options(parser: CommandParser, decided: Collection[str]) -> None:
    """Adds the options of all commands that run many races.

    Args:
        parser: parser of the command.
        decided: fields of ``RaceSettings`` without options, because the command sets them.
    """
    add_options(parser, BatchArguments)
    add_options(parser, RaceSettings, without=decided, group="each race")


def refuse_options(why: str, *options: str) -> None:
    """Refuses options that have no effect.

    Args:
        why: why they have none.
        *options: the options that the user chose.

    Raises:
        ConfigError: there are any.
    """
    if options:
        raise ConfigError(f"{why}; leave out {', '.join(options)}")


def tracks_option() -> Any:
    """Returns a field for ``--track`` that takes several names."""
    return option(
        ("train",),
        flag="--track",
        metavar="TRACK",
        help="names of tracks, or train, train_only, validation, test or all",
    )


def directions_option(*default: str) -> Any:
    """Returns a field for ``--directions``.

    Args:
        *default: names of the default directions.
    """
    return option(default, choices=list(DIRECTIONS), help="directions to drive the tracks")


def chosen_directions(arguments: argparse.Namespace) -> list[bool]:
    """Returns the value of ``reverse`` for each of ``--directions``."""
    return [DIRECTIONS[name] for name in arguments.directions]
