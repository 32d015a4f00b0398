"""Command-line flags from the fields of a settings class, so that each is defined once."""

from __future__ import annotations

import argparse
import types
import typing
from collections.abc import Collection
from dataclasses import fields
from typing import Any

__all__ = ["add_flags", "flags_given"]


def add_flags(parser: Any, settings: type[Any], leave_out: Collection[str] = ()) -> None:
    """Adds a flag for each field: ``--max-steps`` for ``max_steps``.

    Args:
        parser: a parser, or a group of one.
        settings: a dataclass; its fields' metadata have ``help``, and perhaps ``choices``
            and ``metavar``.
        leave_out: fields without a flag.
    """
    kinds = typing.get_type_hints(settings)
    for entry in fields(settings):
        if entry.name in leave_out:
            continue
        options: dict[str, Any] = dict(entry.metadata)
        kind = _plain(kinds[entry.name])
        if kind is bool:
            options["action"] = "store_true"
        else:
            options["type"] = kind
            if kind is int:
                options.setdefault("metavar", "N")
            if "choices" not in options:
                options.setdefault("metavar", entry.name.upper())
            if entry.default is not None:
                options["help"] += " (default: %(default)s)"
        parser.add_argument(_flag(entry.name), default=entry.default, **options)


def flags_given(
    arguments: argparse.Namespace, settings: type[Any], leave_out: Collection[str] = ()
) -> dict[str, Any]:
    """The values of a class's flags, by field."""
    return {
        entry.name: getattr(arguments, entry.name)
        for entry in fields(settings)
        if entry.name not in leave_out
    }


def _flag(name: str) -> str:
    return "--" + name.replace("_", "-")


def _plain(kind: Any) -> Any:
    """``int`` for ``int | None``."""
    if isinstance(kind, types.UnionType):
        kinds = [part for part in typing.get_args(kind) if part is not types.NoneType]
        return kinds[0]
    return kind
