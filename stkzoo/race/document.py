"""What results of races and plans of batches share: a JSON file of a named type and version."""

from __future__ import annotations

import json
import math
import types
import typing
from abc import ABC
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, cast

from typing_extensions import Self  # a dependency of gymnasium

from stkzoo.drivers.failures import printable
from stkzoo.errors import ConfigError, reason
from stkzoo.race.json_values import json_value


class Document(ABC):
    """A dataclass that is kept as a JSON file."""

    __slots__ = ()

    #: The ``type`` and ``schema_version`` of the file.
    kind: ClassVar[str]
    version: ClassVar[int] = 1
    #: Where such a file comes from, for errors.
    origin: ClassVar[str]
    #: A list to write last, with one entry per line.
    rows: ClassVar[str] = ""

    def to_dict(self) -> dict[str, Any]:
        """The document as JSON values, without its type and version."""
        return asdict(self)  # type: ignore[call-overload, no-any-return]  # a dataclass

    def to_json(self) -> str:
        """The document as JSON; never fails (:func:`~stkzoo.race.json_values.json_value`)."""
        document = {"type": self.kind, "schema_version": self.version, **self.to_dict()}
        values = json_value(document)
        if not self.rows:
            return json.dumps(values, indent=2, allow_nan=False)
        rows = ",\n    ".join(map(json.dumps, values.pop(self.rows)))
        text = json.dumps(values, indent=2, allow_nan=False)[:-2]
        return f'{text},\n  "{self.rows}": [\n    {rows}\n  ]\n}}'

    @classmethod
    def from_json(cls, text: str, place: str = "the text") -> Self:
        """Reads the output of :meth:`to_json`.

        Args:
            text: the JSON.
            place: where it was found, for errors.

        Raises:
            ConfigError: the text is something else, or has another version.
        """
        with cls._reading(place):
            values = read_json(text)
            check_document(values, cls.kind, cls.version)
            return cls._decode(values)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], place: str = "the text") -> Self:
        """Reads the output of :meth:`to_dict`; entries that are no fields do not count.

        Raises:
            ConfigError: the values are no such document.
        """
        with cls._reading(place):
            return cls._decode(values)

    @classmethod
    def load(cls, file: Path) -> Self:
        """Reads a file.

        Raises:
            ConfigError: there is none, or it cannot be read.
        """
        try:
            text = file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(
                f"{file} has no {cls._name()} ({reason(error)}); expected {cls.origin}"
            ) from error
        return cls.from_json(text, str(file))

    @classmethod
    def _decode(cls, values: Mapping[str, Any]) -> Self:
        return cast("Self", typed(cls, values))

    @classmethod
    @contextmanager
    def _reading(cls, place: str) -> Iterator[None]:
        """Explains the error of a block that reads a document."""
        try:
            yield
        except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
            raise ConfigError(
                f"{place} has no {cls._name()} ({type(error).__name__}: {error}); expected "
                f"{cls.origin}"
            ) from error

    @classmethod
    def _name(cls) -> str:
        return cls.kind.replace("-", " ")


def read_json(text: str) -> Any:
    """The value of a JSON text. Unlike Python's own reader, it accepts only finite numbers.

    Raises:
        json.JSONDecodeError: the text is not JSON, too deep, or has numbers that are too long.
    """
    try:
        return json.loads(text, parse_constant=_finite, parse_float=_finite)
    except json.JSONDecodeError:
        raise
    except (ValueError, RecursionError) as error:
        raise json.JSONDecodeError(str(error)[:200], "", 0) from None


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text[:20]} is not a finite number")
    return number


def typed(hint: Any, value: Any, name: str = "the document") -> Any:
    """A JSON value as the type of a dataclass's field.

    Objects become dataclasses, without entries that are no fields: later versions may have
    others. Lists become tuples. Texts lose control codes, which a terminal would obey.

    Args:
        hint: the type: a dataclass, a tuple, a dict, a plain type, or one of these or ``None``.
        value: the value.
        name: what it is, for the error.

    Raises:
        TypeError: it has another type, or an entry is missing.
    """
    if isinstance(hint, types.UnionType):
        return None if value is None else typed(typing.get_args(hint)[0], value, name)
    kind: Any = typing.get_origin(hint) or hint
    parts = typing.get_args(hint)
    if isinstance(kind, type) and is_dataclass(kind) and type(value) is dict:
        hints = _hints(kind)
        return kind(**{key: typed(hints[key], value[key], key) for key in value if key in hints})
    if kind is tuple and type(value) is list:
        return tuple(typed(parts[0], entry, name) for entry in value)
    if kind in (dict, Mapping) and type(value) is dict:
        return {printable(key): typed(parts[1], value[key], key) for key in value}
    is_number = kind in (int, float) and type(value) is int
    if (is_number and abs(value) >= 2**63) or (type(value) is not kind and kind is not float):
        raise TypeError(f"{name} is {value!r:.60}, expected {kind.__name__}")
    return printable(value) if kind is str else value


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return typing.get_type_hints(kind)


def check_document(document: Mapping[str, Any], kind: str, version: int) -> None:
    """Checks the type and version of a document.

    Raises:
        ConfigError: it is something else, or of another version.
        KeyError: it has no type or version.
    """
    found = document["type"], document["schema_version"]
    if found != (kind, version):
        raise ConfigError(
            f"the file is a {found[0]} of version {found[1]}, expected a {kind} of version "
            f"{version}; "
            + (
                "another version of stkzoo wrote it"
                if found[0] == kind
                else f"choose the file or folder of a {kind.rpartition('-')[0]}"
            )
        )
