"""Batches: values of several agents, a row for each.

A batch of observations is an array with a row for each agent; a list of texts; or a dict of batches
by entry. The kernel's ``new_batch`` makes batches, and its ``split_batch`` returns their rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

IntArray = npt.NDArray[np.intp]


def form_of(space: spaces.Space[Any]) -> Any:
    """Returns a batch with one row in the form of a space's values, for ``new_batch``.

    Args:
        space: a space whose values have a fixed size.
    """
    if isinstance(space, spaces.Dict):
        return {key: form_of(part) for key, part in space.spaces.items()}
    if isinstance(space, spaces.Text):
        return [""]
    return np.empty((1, *(space.shape or ())), space.dtype)


def write_rows(batch: Any, rows: IntArray, values: Any) -> None:
    """Writes values into rows of a batch.

    Args:
        batch: the batch.
        rows: rows to write.
        values: a batch with as many rows, or one value for all of them.
    """
    if isinstance(batch, dict):
        for key, value in values.items():
            write_rows(batch[key], rows, value)
    elif isinstance(batch, list):
        for place, row in enumerate(rows.tolist()):
            batch[row] = values if isinstance(values, str) else values[place]
    else:
        batch[rows] = values


def copied_rows(batch: Any, rows: IntArray) -> Any:
    """Returns a batch with copies of some rows of another one."""
    if isinstance(batch, Mapping):
        return {key: copied_rows(part, rows) for key, part in batch.items()}
    if isinstance(batch, (list, tuple)):
        return [batch[row] for row in rows.tolist()]
    return batch[rows]
