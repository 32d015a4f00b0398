"""Many agents' values of one space as arrays, and back.

The *batch form* of a value has the agents as the leading axis: ``(A,)`` for ``Discrete``
and ``Text``, ``(A, *shape)`` for ``Box`` and its like, ``(A, M, ...)`` for ``Sequence``, a
dict of these for ``Dict``. The *single form* is Gymnasium's own: ``int``, ``str``, array,
tuple, dict.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

__all__ = ["space_identity", "split", "take"]

IntArray = npt.NDArray[np.intp]


def take(space: spaces.Space[Any], batch: Any, rows: Sequence[int] | IntArray | slice) -> Any:
    """The given rows of a batch, without the dict entries that the space does not have."""
    if isinstance(space, spaces.Dict):
        return {key: take(part, batch[key], rows) for key, part in space.spaces.items()}
    return batch[rows]


def split(space: spaces.Space[Any], batch: Any) -> list[Any]:
    """The single forms of a batch, which share no memory with it.

    Args:
        space: the space of each single form.
        batch: values in batch form.

    Returns:
        One value for each row.
    """
    if isinstance(space, spaces.Dict):
        columns = [split(part, batch[key]) for key, part in space.spaces.items()]
        keys = tuple(space.spaces)
        return [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)]
    if isinstance(space, (spaces.Discrete, spaces.Text)):
        values: list[Any] = np.asarray(batch).tolist()
        return values
    if isinstance(space, spaces.Sequence):
        return [tuple(row) for row in np.array(batch)]
    return list(np.array(batch)) if isinstance(batch, np.ndarray) else list(batch)


def space_identity(space: spaces.Space[Any]) -> Hashable:
    """Something hashable that is equal for spaces that are certainly equal."""
    if isinstance(space, spaces.Dict):
        parts = space.spaces.items()
        return type(space), tuple((key, space_identity(part)) for key, part in parts)
    if isinstance(space, spaces.Sequence):
        return type(space), space_identity(space.feature_space)
    if isinstance(space, spaces.Box):
        return type(space), space.shape, str(space.dtype), space.low.tobytes(), space.high.tobytes()
    if isinstance(space, spaces.Discrete):
        return type(space), int(space.n), int(space.start), str(space.dtype)
    if isinstance(space, spaces.MultiDiscrete):
        bounds = space.nvec.tobytes(), space.start.tobytes()
        return type(space), space.shape, str(space.dtype), bounds
    if isinstance(space, spaces.Text):
        return type(space), space.min_length, space.max_length, space.character_set
    return type(space), id(space)
