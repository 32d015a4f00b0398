"""Conversion of JSON values to dataclasses, whose annotations define types and bounds.

>>> @dataclass
... class Kart:
...     place: Annotated[int, Within(1, 20)]
>>> typed(Kart, {"place": 3})
Kart(place=3)
>>> typed(Kart, {"place": 0})
Traceback (most recent call last):
    ...
stkzoo._reading.Unreadable: place is 0, expected a value from 1 to 20
"""

from __future__ import annotations

import math
import re
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, TypeVar, cast

from stkzoo._reading import Unreadable
from stkzoo.errors import ConfigError, shortened

__all__ = [
    "Count",
    "Level",
    "Matching",
    "OneOf",
    "Place",
    "Positive",
    "Seconds",
    "Share",
    "Whole",
    "Within",
    "plain_text",
    "typed",
]

T = TypeVar("T")
_Reader = Callable[[Any], Any]

#: Limit of whole numbers. Larger ones do not fit into arrays.
_MAX_WHOLE = 2**63
#: Letters that :func:`plain_text` replaces.
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
#: Maximum nesting depth of a value without a type.
_MAX_DEPTH = 16


@dataclass(frozen=True, slots=True)
class Within:
    """Bounds of a number, or of the length of a text, list or object.

    Attributes:
        low: the lowest valid value.
        high: the highest valid value.
        is_above: whether ``low`` itself is invalid.
    """

    low: float
    high: float = math.inf
    is_above: bool = False

    def accepts(self, value: Any) -> bool:
        """Returns whether a value is within the bounds."""
        number = value if isinstance(value, (int, float)) else len(value)
        return self.low <= number <= self.high and not (self.is_above and number == self.low)

    def expected(self, value: Any) -> str:
        """Returns the bounds as text for an error."""
        noun = "a value" if isinstance(value, (int, float)) else "a length"
        if self.is_above:
            return f"{noun} above {self.low:g}"
        if self.high == math.inf:
            return f"{noun} of {self.low:g} or more"
        return f"{noun} from {self.low:g} to {self.high:g}"


@dataclass(frozen=True, slots=True)
class OneOf:
    """The valid values of a field."""

    values: tuple[object, ...]

    def accepts(self, value: Any) -> bool:
        """Returns whether a value is valid."""
        return value in self.values

    def expected(self, value: Any) -> str:  # noqa: ARG002 - the same for all
        """Returns the valid values as text for an error."""
        return f"one of {', '.join(map(str, self.values))}"


@dataclass(frozen=True, slots=True)
class Matching:
    """The required pattern of a text.

    Attributes:
        pattern: a regular expression for the whole text.
        noun: description of a valid text in errors.
    """

    pattern: str
    noun: str

    def accepts(self, value: Any) -> bool:
        """Returns whether a text matches the pattern."""
        return re.fullmatch(self.pattern, value) is not None

    def expected(self, value: Any) -> str:  # noqa: ARG002 - the same for all
        """Returns the description of a valid text."""
        return self.noun


#: Common types with bounds.
Count = Annotated[int, Within(0)]
Whole = Annotated[int, Within(1)]
Level = Annotated[int, Within(0, 3)]
Place = Annotated[int, Within(1, 256)]
Positive = Annotated[float, Within(0, is_above=True)]
Seconds = Annotated[float, Within(0)]
Share = Annotated[float, Within(0, 1)]


def plain_text(text: str) -> str:
    """Returns a text in which ``?`` replaces codes that could affect a terminal.

    These are control codes except line feeds and tabs, line and paragraph separators, codes that
    change the direction of text, and bytes that are not UTF-8.
    """
    return text if text.isprintable() else _CONTROL.sub("?", text)


def typed(hint: type[T], value: Any) -> T:
    """Converts a JSON value to a type and checks its bounds.

    Objects become dataclasses. Entries that are not fields are ignored, because later versions may
    add entries. Lists become tuples if the type is a tuple. Control codes in texts are replaced.

    Args:
        hint: a dataclass, tuple, list, dict or plain type; a union of one of these and ``None``;
            or one of these annotated with :class:`Within`, :class:`OneOf` or :class:`Matching`.
        value: the value.

    Raises:
        Unreadable: the value has another type or is out of bounds, or a field is missing.
    """
    return cast("T", _reader(cast("Any", hint))(value))


@cache
def _reader(hint: Any) -> _Reader:
    """Returns the function that converts values to a type."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return _read_any
    if hasattr(origin, "__value__"):  # an alias, such as NDArray since NumPy 2.5
        return _reader(origin.__value__[parts])
    if origin is Annotated:
        return _bounded(_reader(parts[0]), parts[1:])
    if origin in (types.UnionType, typing.Union):
        return _optional(_reader(next(part for part in parts if part is not types.NoneType)))
    if is_dataclass(hint):
        return _object(hint)
    if origin in (tuple, list, Sequence):
        if origin is tuple and parts[-1] is not Ellipsis:
            return _fixed(list(map(_reader, parts)))
        return _several(list if origin is list else tuple, _reader(parts[0]))
    if origin in (dict, Mapping):
        return _mapping(_reader(parts[1]))
    return _PLAIN.get(hint) or _instance(origin or hint)


def _bounded(read: _Reader, bounds: Sequence[Any]) -> _Reader:
    def bounded(value: Any) -> Any:
        found = read(value)
        for bound in bounds:
            if not bound.accepts(found):
                raise _wrong(value, bound.expected(found))
        return found

    return bounded


def _optional(read: _Reader) -> _Reader:
    return lambda value: None if value is None else read(value)


def _object(kind: Any) -> _Reader:
    hints = typing.get_type_hints(kind, include_extras=True)
    entries = [
        (field.name, hints[field.name], field.default is MISSING is field.default_factory)
        for field in fields(kind)
    ]

    def read(value: Any) -> Any:
        if type(value) is not dict:
            raise _wrong(value, "an object")
        values = {}
        for name, hint, is_required in entries:
            if name in value:
                try:
                    values[name] = _reader(hint)(value[name])
                except Unreadable as error:
                    raise error.inside(f".{name}") from None
            elif is_required:
                raise Unreadable("is missing", f".{name}")
        try:
            return kind(**values)
        except ConfigError as error:
            raise Unreadable(str(error)) from None

    return read


def _several(kind: type, read: _Reader) -> _Reader:
    def several(value: Any) -> Any:
        if type(value) is not list:
            raise _wrong(value, "a list")
        return kind(map(_numbered, value, range(len(value))))

    def _numbered(entry: Any, number: int) -> Any:
        try:
            return read(entry)
        except Unreadable as error:
            raise error.inside(f"[{number}]") from None

    return several


def _fixed(reads: Sequence[_Reader]) -> _Reader:
    def fixed(value: Any) -> Any:
        if type(value) is not list or len(value) != len(reads):
            raise _wrong(value, f"a list of {len(reads)}")
        return tuple(read(entry) for read, entry in zip(reads, value, strict=True))

    return fixed


def _mapping(read: _Reader) -> _Reader:
    def mapping(value: Any) -> Any:
        if type(value) is not dict:
            raise _wrong(value, "an object")
        found = {}
        for key, entry in value.items():
            name = plain_text(key)
            try:
                found[name] = read(entry)
            except Unreadable as error:
                raise error.inside(f".{name[:60]}") from None
        return found

    return mapping


def _read_bool(value: Any) -> bool:
    if type(value) is not bool:
        raise _wrong(value, "true or false")
    return value


def _read_int(value: Any) -> int:
    if type(value) is not int or not -_MAX_WHOLE < value < _MAX_WHOLE:
        raise _wrong(value, "a whole number")
    return value


def _read_float(value: Any) -> float:
    if type(value) is float and math.isfinite(value):
        return value
    if type(value) is not int or not -_MAX_WHOLE < value < _MAX_WHOLE:
        raise _wrong(value, "a finite number")
    return value


def _read_str(value: Any) -> str:
    if type(value) is not str:
        raise _wrong(value, "text")
    return plain_text(value)


def _read_any(value: Any, depth: int = _MAX_DEPTH) -> Any:
    """Returns a value of any type, after checking its depth, numbers and texts."""
    if depth == 0:
        raise Unreadable("is nested too deep")
    if type(value) is list:
        return [_read_any(entry, depth - 1) for entry in value]
    if type(value) is dict:
        return {plain_text(key): _read_any(entry, depth - 1) for key, entry in value.items()}
    if value is None or type(value) is bool:
        return value
    return _read_str(value) if type(value) is str else _read_float(value)


def _instance(kind: type) -> _Reader:
    """Returns a function that only accepts instances of a class."""

    def instance(value: Any) -> Any:
        if not isinstance(value, kind):
            raise _wrong(value, kind.__name__)
        return value

    return instance


_PLAIN: dict[Any, _Reader] = {
    bool: _read_bool,
    int: _read_int,
    float: _read_float,
    str: _read_str,
}


def _wrong(value: Any, expected: str) -> Unreadable:
    return Unreadable(f"is {shortened(value)}, expected {expected}")
