"""Arguments that several commands share, and how they are checked."""

from __future__ import annotations

import argparse
import functools
import types
import typing
from collections.abc import Callable, Collection
from dataclasses import Field, fields
from typing import Any

from stkzoo.errors import ConfigError

#: ``reverse`` by the names of ``--directions``.
DIRECTIONS = {"forward": False, "reversed": True}


def usage_errors(run: Callable[[argparse.Namespace], int]) -> Callable[[argparse.Namespace], int]:
    """Reports a command's ``ConfigError`` with its usage and exit code 2, as argparse does."""

    @functools.wraps(run)
    def checked(arguments: argparse.Namespace) -> int:
        try:
            return run(arguments)
        except ConfigError as error:
            arguments.fail(str(error))
            raise  # not reached: fail() exits

    return checked


def add_settings(
    parser: argparse.ArgumentParser,
    title: str,
    decided: Collection[str] = (),
    only: Collection[str] | None = None,
) -> None:
    """Adds an option for each field of ``RaceSettings``: ``--max-steps`` for ``max_steps``.

    Args:
        parser: the command's parser.
        title: of the group of options.
        decided: fields that the command sets itself.
        only: the fields to add; ``None`` for all.
    """
    from stkzoo.race import RaceSettings

    group = parser.add_argument_group(title)
    kinds = typing.get_type_hints(RaceSettings)
    for entry in _fields(decided, only):
        options: dict[str, Any] = dict(entry.metadata)
        kind = _without_none(kinds[entry.name])
        if kind is bool:
            options["action"] = "store_true"
        else:
            options["type"] = kind
            if "choices" not in options:
                options.setdefault("metavar", "N" if kind is int else entry.name.upper())
            if entry.default is not None:
                options["help"] += " (default: %(default)s)"
        group.add_argument(f"--{entry.name.replace('_', '-')}", default=entry.default, **options)


def settings_of(
    arguments: argparse.Namespace,
    decided: Collection[str] = (),
    only: Collection[str] | None = None,
) -> dict[str, Any]:
    """The values of the options that :func:`add_settings` added, by field."""
    return {entry.name: getattr(arguments, entry.name) for entry in _fields(decided, only)}


def _fields(decided: Collection[str], only: Collection[str] | None) -> list[Field[Any]]:
    from stkzoo.race import RaceSettings

    return [
        entry
        for entry in fields(RaceSettings)
        if entry.name not in decided and (only is None or entry.name in only)
    ]


def _without_none(kind: Any) -> Any:
    """``int`` for ``int | None``."""
    if isinstance(kind, types.UnionType):
        return next(part for part in typing.get_args(kind) if part is not types.NoneType)
    return kind


def add_batch_options(parser: argparse.ArgumentParser, decided: Collection[str]) -> None:
    """Adds the options of all commands that run many races.

    Args:
        parser: the command's parser.
        decided: fields of ``RaceSettings`` that the command sets itself.
    """
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="races at a time (default: all CPU cores)"
    )
    parser.add_argument(
        "--race-timeout",
        type=float,
        default=3600.0,
        metavar="SECONDS",
        help="time limit of one race (default: %(default)s)",
    )
    add_settings(parser, "each race", decided)


def add_tracks(parser: argparse.ArgumentParser) -> None:
    """Adds ``--tracks``."""
    parser.add_argument(
        "--tracks",
        nargs="+",
        default=["train"],
        metavar="TRACK",
        help="names of tracks, or train, test or all (default: train)",
    )


def add_directions(parser: argparse.ArgumentParser, *default: str) -> None:
    """Adds ``--directions``."""
    parser.add_argument(
        "--directions",
        nargs="+",
        default=default,
        choices=list(DIRECTIONS),
        help=f"default: {' '.join(default)}",
    )


def chosen_directions(arguments: argparse.Namespace) -> list[bool]:
    """``reverse`` for each of ``--directions``."""
    return [DIRECTIONS[name] for name in arguments.directions]
