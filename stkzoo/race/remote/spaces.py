"""Gymnasium spaces as plain data for messages (:mod:`stkzoo.race.codec`).

Only the kinds of spaces that the ``full`` view consists of can be sent.

>>> from gymnasium import spaces
>>> space = spaces.Dict({"steer": spaces.Box(-1, 1, (1,)), "fire": spaces.Discrete(2)})
>>> space_from_data(space_to_data(space)) == space
True
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from stkzoo.errors import ProtocolError

Space = spaces.Space[Any]
Data = dict[str, Any]

#: A small message may describe a space with large samples; stkzoo's own are far below this.
_MAX_SAMPLE = 1 << 20


def space_to_data(space: Space) -> Data:
    """A space as a dict of plain data.

    Raises:
        ProtocolError: this kind of space cannot be sent.
    """
    kind = type(space).__name__
    if kind not in _WRITERS:
        raise ProtocolError(
            f"a space of type {kind} cannot be sent, expected one of {', '.join(_WRITERS)}"
        )
    return {"space": kind, **_WRITERS[kind](space)}


def space_from_data(data: object) -> Space:
    """The space that :func:`space_to_data` described.

    Raises:
        ProtocolError: the data does not describe a space.
    """
    kind = data.get("space") if isinstance(data, Mapping) else None
    if not isinstance(data, Mapping) or not isinstance(kind, str) or kind not in _READERS:
        raise ProtocolError(f"a space came as {data!r:.200}, expected {', '.join(_READERS)}")
    try:
        return _READERS[kind](data)
    except ProtocolError:
        raise
    except Exception as error:  # gymnasium reports bad arguments in many ways, also by assert
        raise ProtocolError(f"an invalid {kind} space came: {error!r:.200}") from error


def _read_box(data: Mapping[str, Any]) -> Space:
    low, high = data["low"], data["high"]
    if not isinstance(low, np.ndarray) or not isinstance(high, np.ndarray):
        raise ProtocolError("a Box came without arrays for low and high")
    return spaces.Box(low, high, low.shape, low.dtype.type)


def _read_discrete(data: Mapping[str, Any]) -> Space:
    return spaces.Discrete(data["n"], start=data["start"], dtype=_integer_type(data["dtype"]))


def _read_text(data: Mapping[str, Any]) -> Space:
    longest, shortest = _bounded(data["max_length"]), _bounded(data["min_length"])
    return spaces.Text(longest, min_length=shortest, charset=data["charset"])


def _read_dict(data: Mapping[str, Any]) -> Space:
    whole = spaces.Dict()  # its constructor sorts the keys; assignment keeps their order
    for key, part in data["spaces"]:
        if not isinstance(key, str):
            raise ProtocolError(f"a Dict space came with the key {key!r:.100}, expected text")
        whole[key] = space_from_data(part)
    return whole


def _read_sequence(data: Mapping[str, Any]) -> Space:
    return spaces.Sequence(space_from_data(data["feature"]), stack=bool(data["stack"]))


def _integer_type(name: object) -> Any:
    if not isinstance(name, str) or name.lstrip("u") not in ("int8", "int16", "int32", "int64"):
        raise ProtocolError(f"the dtype {name!r:.50} came, expected an integer type")
    return np.dtype(name).type


def _bounded(size: object) -> int:
    if type(size) is not int or not 0 <= size <= _MAX_SAMPLE:
        raise ProtocolError(f"the size {size!r:.50} came, expected 0 to {_MAX_SAMPLE}")
    return size


_WRITERS: dict[str, Callable[[Any], Data]] = {
    "Box": lambda space: {"low": space.low, "high": space.high},
    "Discrete": lambda space: {
        "n": int(space.n),
        "start": int(space.start),
        "dtype": space.dtype.name,
    },
    "Text": lambda space: {
        "max_length": space.max_length,
        "min_length": space.min_length,
        "charset": "".join(space.character_list),
    },
    "Dict": lambda space: {"spaces": [[k, space_to_data(v)] for k, v in space.spaces.items()]},
    "Sequence": lambda space: {
        "feature": space_to_data(space.feature_space),
        "stack": bool(space.stack),
    },
}

_READERS: dict[str, Callable[[Mapping[str, Any]], Space]] = {
    "Box": _read_box,
    "Discrete": _read_discrete,
    "Text": _read_text,
    "Dict": _read_dict,
    "Sequence": _read_sequence,
}
