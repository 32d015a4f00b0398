"""Checks of arguments, and the errors for invalid ones."""

from __future__ import annotations

import difflib
import functools
import inspect
import math
import numbers
import operator
from collections.abc import Hashable, Iterable
from typing import Any, TypeVar

from stkzoo.errors import MAX_LINE, ArgumentNameError, ConfigError

Kind = TypeVar("Kind", bound=type)

#: Maximum number of elements of an array that :func:`shortened` shows.
_MAX_SHOWN = 1000


def check_whole(name: str, value: object, low: int, high: int | None = None) -> int:
    """Checks that a value is a whole number within bounds, and returns it as an int.

    Args:
        name: name of the value in the error text, such as ``"jobs"``.
        value: the value.
        low: lowest valid value.
        high: highest valid value; ``None`` for no bound.

    Raises:
        ConfigError: the value is not a whole number or out of bounds.
    """
    try:
        number = low - 1 if isinstance(value, bool) else operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = low - 1
    if number < low or (high is not None and number > high):
        bounds = f"of {low} or more" if high is None else f"from {low} to {high}"
        raise ConfigError(f"{name} is {shortened(value)}, expected a whole number {bounds}")
    return number


def check_number(
    name: str,
    value: object,
    low: float = 0.0,
    high: float | None = None,
    *,
    unit: str = "",
    is_finite: bool = True,
) -> float:
    """Checks that a value is a number within bounds, and returns it as a float.

    Args:
        name: name of the value in the error text, such as ``"step_size"``.
        value: the value.
        low: lowest valid value; without ``high``, the value must be above ``low``.
        high: highest valid value; ``None`` for no bound.
        unit: unit of the value in the error text, such as ``"seconds"``.
        is_finite: whether infinity is invalid.

    Raises:
        ConfigError: the value is not a number or out of bounds.
    """
    is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    try:
        number = float(value) if is_number else math.nan  # type: ignore[arg-type]
    except OverflowError:
        number = math.inf
    if high is not None:
        is_valid, bounds = low <= number <= high, f"from {low:g} to {high:g}"
    else:
        is_valid, bounds = low < number and (number < math.inf or not is_finite), f"above {low:g}"
    if not is_valid:
        what = f"a number of {unit}" if unit else "a number"
        raise ConfigError(f"{name} is {shortened(value)}, expected {what} {bounds}")
    return number


def check_flag(name: str, value: object) -> bool:
    """Checks that a value equals ``True`` or ``False``, and returns it as a bool.

    Args:
        name: name of the value in the error text.
        value: the value.

    Raises:
        ConfigError: the value is neither.
    """
    if not isinstance(value, Hashable) or value not in (True, False):
        raise ConfigError(f"{name} is {shortened(value)}, expected True or False")
    return bool(value)


def unknown_name(noun: str, name: object, known: Iterable[str]) -> ConfigError:
    """Returns the error for an unknown name. It suggests the nearest valid name or lists all.

    Args:
        noun: what the name identifies, such as ``"track"``.
        name: the unknown name.
        known: the valid names.
    """
    return ConfigError(_with_names(f"unknown {noun} {shortened(name)}", name, known))


def unknown_argument(name: str, known: Iterable[str]) -> ArgumentNameError:
    """Returns the error for an unknown keyword argument, in Python's words and with a suggestion.

    Args:
        name: the unknown name.
        known: the valid names.
    """
    return ArgumentNameError(_with_names(f"unexpected keyword argument {name!r}", name, known))


def _with_names(cause: str, name: object, known: Iterable[str]) -> str:
    """Returns the text of an error with the nearest valid name, all names, or both."""
    known = sorted(known)
    near = difflib.get_close_matches(str(name), known, n=1)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    text = f"{cause}.{hint}"
    names = f"Known: {', '.join(known)}."
    if len(text) + len(names) < MAX_LINE:
        return f"{text} {names}"
    return text if hint else f"{text} Choose a name from the list:\n{names}"


def check_arguments(checked_class: Kind) -> Kind:
    """Class decorator whose error for an unknown keyword suggests the nearest valid one.

    If the class has an argument ``num_kart``, its constructor also accepts ``num_karts``.

    Args:
        checked_class: the class.
    """
    make: Any = checked_class.__init__  # type: ignore[misc]
    known = list(inspect.signature(make).parameters)[1:]

    @functools.wraps(make)
    def checked(self: object, *values: object, **keywords: object) -> None:
        if "num_karts" in keywords and "num_kart" in known:
            if "num_kart" in keywords:
                raise ConfigError("num_kart and num_karts are the same argument; give one of them")
            keywords["num_kart"] = keywords.pop("num_karts")
        for name in keywords:
            if name not in known:
                raise unknown_argument(name, known)
        make(self, *values, **keywords)

    checked_class.__init__ = checked  # type: ignore[misc]
    return checked_class


def shortened(value: object, limit: int = 60) -> str:
    """Returns the ``repr`` of a value, shortened to a maximum length.

    A large array is described by its shape and dtype.

    Args:
        value: the value.
        limit: maximum length [characters].
    """
    type_name = type(value).__name__
    if type_name == "ndarray" and getattr(value, "size", 0) > _MAX_SHOWN:
        return f"an array of shape {value.shape} and dtype {value.dtype}"  # type: ignore[attr-defined]
    try:
        text = repr(value)
    except Exception:  # noqa: BLE001 - a user's __repr__ can raise any error
        text = f"({type_name}: its __repr__ failed)"
    return text if len(text) <= limit else f"{text[: limit - 3]}..."
