"""Gymnasium spaces as plain data, so that they can go into a message (:mod:`stkzoo.race.codec`).

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

__all__ = ["space_from_data", "space_to_data"]

Space = spaces.Space[Any]
Data = dict[str, Any]

#: A space of few bytes may ask for large samples; none of ours comes near.
_MAX_SAMPLE = 1 << 20


def space_to_data(space: Space) -> Data:
    """A space as a dict of plain data.

    Raises:
        ProtocolError: a kind of space that cannot be sent.
    """
    kind = type(space).__name__
    if kind not in _WRITERS:
        raise ProtocolError(
            f"a space of type {kind} cannot be sent, expected one of {', '.join(_WRITERS)}"
        )
    return {"space": kind, **_WRITERS[kind](space)}


def space_from_data(data: object) -> Space:
    """The space that :func:`space_to_data` was given.

    Raises:
        ProtocolError: the data is no space's.
    """
    kind = data.get("space") if isinstance(data, Mapping) else None
    if not isinstance(data, Mapping) or not isinstance(kind, str) or kind not in _READERS:
        raise ProtocolError(f"a space came as {data!r:.200}, expected {', '.join(_READERS)}")
    try:
        return _READERS[kind](data)
    except ProtocolError:
        raise
    except Exception as error:  # gymnasium tells of bad arguments in many ways, asserts too
        raise ProtocolError(f"a {kind} space came that cannot be: {error!r:.200}") from error


def _write_box(space: Any) -> Data:
    return {"low": space.low, "high": space.high}


def _read_box(data: Mapping[str, Any]) -> Space:
    low, high = data["low"], data["high"]
    if not isinstance(low, np.ndarray) or not isinstance(high, np.ndarray):
        raise ProtocolError("a Box came without arrays for low and high")
    return spaces.Box(low, high, low.shape, low.dtype.type)


def _write_discrete(space: Any) -> Data:
    return {"n": int(space.n), "start": int(space.start), "dtype": space.dtype.name}


def _read_discrete(data: Mapping[str, Any]) -> Space:
    return spaces.Discrete(data["n"], start=data["start"], dtype=_whole_type(data["dtype"]))


def _write_multi_discrete(space: Any) -> Data:
    return {"nvec": space.nvec, "start": space.start}


def _read_multi_discrete(data: Mapping[str, Any]) -> Space:
    nvec = np.asarray(data["nvec"])
    return spaces.MultiDiscrete(nvec, dtype=_whole_type(nvec.dtype.name), start=data["start"])


def _write_multi_binary(space: Any) -> Data:
    return {"n": [int(size) for size in np.atleast_1d(space.n)], "is_flat": np.ndim(space.n) == 0}


def _read_multi_binary(data: Mapping[str, Any]) -> Space:
    sizes = [_bounded(size) for size in data["n"]]
    _bounded(int(np.prod([float(size) for size in sizes])))
    return spaces.MultiBinary(sizes[0] if data["is_flat"] else sizes)


def _write_text(space: Any) -> Data:
    return {
        "max_length": space.max_length,
        "min_length": space.min_length,
        "charset": "".join(space.character_list),
    }


def _read_text(data: Mapping[str, Any]) -> Space:
    return spaces.Text(
        _bounded(data["max_length"]),
        min_length=_bounded(data["min_length"]),
        charset=data["charset"],
    )


def _write_dict(space: Any) -> Data:
    return {"spaces": [[key, space_to_data(part)] for key, part in space.spaces.items()]}


def _read_dict(data: Mapping[str, Any]) -> Space:
    parts = {}
    for key, part in data["spaces"]:
        if not isinstance(key, str):
            raise ProtocolError(f"a Dict space came with the key {key!r:.100}, expected text")
        parts[key] = space_from_data(part)
    whole = spaces.Dict()  # which sorts what it is made of, but keeps what is added in order
    for key, space in parts.items():
        whole[key] = space
    return whole


def _write_tuple(space: Any) -> Data:
    return {"spaces": [space_to_data(part) for part in space.spaces]}


def _read_tuple(data: Mapping[str, Any]) -> Space:
    return spaces.Tuple([space_from_data(part) for part in data["spaces"]])


def _write_sequence(space: Any) -> Data:
    return {"feature": space_to_data(space.feature_space), "stack": bool(space.stack)}


def _read_sequence(data: Mapping[str, Any]) -> Space:
    return spaces.Sequence(space_from_data(data["feature"]), stack=bool(data["stack"]))


def _whole_type(name: object) -> Any:
    if not isinstance(name, str) or name.lstrip("u") not in ("int8", "int16", "int32", "int64"):
        raise ProtocolError(f"the dtype {name!r:.50} came, expected one of whole numbers")
    return np.dtype(name).type


def _bounded(size: object) -> int:
    if type(size) is not int or not 0 <= size <= _MAX_SAMPLE:
        raise ProtocolError(f"the size {size!r:.50} came, expected 0 to {_MAX_SAMPLE}")
    return size


_WRITERS: dict[str, Callable[[Any], Data]] = {
    "Box": _write_box,
    "Discrete": _write_discrete,
    "MultiDiscrete": _write_multi_discrete,
    "MultiBinary": _write_multi_binary,
    "Text": _write_text,
    "Dict": _write_dict,
    "Tuple": _write_tuple,
    "Sequence": _write_sequence,
}

_READERS: dict[str, Callable[[Mapping[str, Any]], Space]] = {
    "Box": _read_box,
    "Discrete": _read_discrete,
    "MultiDiscrete": _read_multi_discrete,
    "MultiBinary": _read_multi_binary,
    "Text": _read_text,
    "Dict": _read_dict,
    "Tuple": _read_tuple,
    "Sequence": _read_sequence,
}
