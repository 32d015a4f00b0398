"""Checks of arguments, and the errors for invalid ones."""

from __future__ import annotations

import difflib
import functools
import inspect
import math
import numbers
import operator
import re
from collections.abc import Collection, Hashable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np

from stkzoo.errors import MAX_LINE, ArgumentNameError, ConfigError

Kind = TypeVar("Kind", bound=type)

#: Least similarity of a name that an error suggests, and least length of a part of one.
_NEAR, _MIN_PART = 0.7, 3


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


def check_type(name: str, value: object, valid: Any, expected: str) -> Any:
    """Checks the type of a value, and returns the value.

    Args:
        name: name of the value in the error text.
        value: the value.
        valid: a type or several, as for ``isinstance``. Texts are no ``Sequence``.
        expected: what was expected, for the error text.

    Raises:
        ConfigError: the value has another type.
    """
    is_text = valid is Sequence and isinstance(value, (str, bytes))
    if is_text or not isinstance(value, valid):
        raise ConfigError(f"{name} is {shortened(value)}, expected {expected}")
    return value


def check_name(noun: str, name: object, known: Collection[str], owner: str = "") -> str:
    """Checks that a name is valid, and returns it.

    Args:
        noun: see :func:`unknown_name`, as for the other arguments.
        name: the name.
        known: the valid names.
        owner: what has the name.

    Raises:
        ConfigError: it is not.
    """
    if not isinstance(name, str) or name not in known:
        raise unknown_name(noun, name, known, owner)
    return name


def unknown_name(noun: str, name: object, known: Iterable[str], owner: str = "") -> ConfigError:
    """Returns the error for an unknown name. It suggests a valid name that is near, or lists all.

    Args:
        noun: what the name identifies, such as ``"track"``.
        name: the unknown name.
        known: the valid names.
        owner: what has the name, such as ``" of the simple view"``.
    """
    return ConfigError(_with_names(f"unknown {noun} {shortened(name)}{owner}", name, known))


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
    near = _nearest(str(name), known)
    hint = f" Did you mean {near!r}?" if near else ""
    text = f"{cause}.{hint}"
    names = f"Known: {', '.join(known) or 'none'}."
    if len(text) + len(names) < MAX_LINE:
        return f"{text} {names}"
    return text if hint else f"{text} Choose a name from the list:\n{names}"


def _nearest(name: str, known: Iterable[str]) -> str | None:
    """Returns the valid name that an unknown one probably stands for; ``None`` if none is near.

    Near is a name with similar letters, whatever their case, and the same digits: ``kart_0`` is not
    near ``kart_7``. Otherwise, it is the only name that contains the unknown one or is part of it.
    """
    name, by_letters = name.lower(), {entry.lower(): entry for entry in known}
    digits = re.sub(r"\D", "", name)
    alike = [entry for entry in by_letters if re.sub(r"\D", "", entry) == digits]
    near = difflib.get_close_matches(name, alike, n=1, cutoff=_NEAR)
    if not near:
        parts = [entry for entry in by_letters if len(entry) >= _MIN_PART <= len(name)]
        near = [entry for entry in parts if entry in name or name in entry]
        near = near if len(near) == 1 else []
    return by_letters[near[0]] if near else None


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
    """Returns the ``repr`` of a value in one line, shortened to a maximum length.

    An array or tensor that is too long is described by its shape and dtype.

    Args:
        value: the value.
        limit: maximum length [characters].
    """
    try:
        with np.printoptions(threshold=limit, edgeitems=1):  # else many axes have a huge repr
            text = re.sub(r"\s*\n\s*", " ", repr(value))
        is_long = len(text) > limit or math.prod(getattr(value, "shape", None) or ()) > limit
        if is_long and hasattr(value, "shape") and hasattr(value, "dtype"):
            return f"an array of shape {tuple(value.shape)} and dtype {value.dtype}"
    except Exception:  # noqa: BLE001 - a user's __repr__ can raise any error
        text = f"({type(value).__name__}: its __repr__ failed)"
    return text if len(text) <= limit else f"{text[: limit - 3]}..."
