"""Many agents' values of one space as arrays, and back.

The *batch form* of a value has the agents as the leading axis: ``(A,)`` for ``Discrete``
and ``Text``, ``(A, *shape)`` for ``Box`` and its like, ``(A, M, ...)`` for ``Sequence``, a
dict of these for ``Dict``. The *single form* is Gymnasium's own: ``int``, ``str``, array,
tuple, dict.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

__all__ = ["split"]


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
