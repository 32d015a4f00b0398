"""Whether a value is in a space, and if not, which part of it is at fault."""

from __future__ import annotations

import reprlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

__all__ = ["arrays_in", "fault_in"]


def fault_in(space: spaces.Space[Any], value: Any, path: str) -> str | None:
    """What keeps a value out of a space, in words; ``None`` if it is in it.

    Stricter than ``space.contains``: arrays must have the space's own dtype.

    Args:
        space: the space.
        value: the value.
        path: what the value is called in the text.
    """
    if isinstance(space, spaces.Dict):
        return _fault_in_dict(space, value, path)
    if isinstance(space, spaces.Sequence) and isinstance(value, tuple):
        parts = ((space.feature_space, entry, f"{path}[{i}]") for i, entry in enumerate(value))
        return next(filter(None, (fault_in(*part) for part in parts)), None)
    if isinstance(value, np.ndarray) and space.dtype is not None and value.dtype != space.dtype:
        return f"{path} has dtype {value.dtype}, expected {space.dtype}"
    if not space.contains(value):
        return f"{path} is {reprlib.repr(value)}, expected a value of {space}"
    return None


def _fault_in_dict(space: spaces.Dict, value: Any, path: str) -> str | None:
    if not isinstance(value, Mapping):
        return f"{path} is a {type(value).__name__}, expected a dict"
    if value.keys() != space.spaces.keys():
        missing = [key for key in space.spaces if key not in value]
        unknown = [key for key in value if key not in space.spaces]
        return f"{path} lacks the keys {missing} and has the unknown keys {unknown}"
    parts = ((part, value[key], f"{path}[{key!r}]") for key, part in space.spaces.items())
    return next(filter(None, (fault_in(*part) for part in parts)), None)


def arrays_in(value: Any, path: str) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """All arrays inside nested dicts, tuples and lists, with their paths."""
    if isinstance(value, np.ndarray):
        yield path, value
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            yield from arrays_in(entry, f"{path}[{key!r}]")
    elif isinstance(value, (tuple, list)):
        for number, entry in enumerate(value):
            yield from arrays_in(entry, f"{path}[{number}]")
