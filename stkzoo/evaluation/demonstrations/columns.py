"""Values of a space as arrays by name, so that a file of arrays can hold them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Space

__all__ = ["Columns", "columns_of", "tree_of"]

Columns = dict[str, npt.NDArray[Any]]


def columns_of(name: str, space: Space[Any], values: Sequence[Any]) -> Columns:
    """Values with time as the leading axis; a dict's entries are ``name/key``."""
    parts = getattr(space, "spaces", None)
    if not isinstance(parts, Mapping):
        shape = space.shape or ()
        return {name: np.array(values, space.dtype).reshape(len(values), *shape)}
    columns: Columns = {}
    for key, part in parts.items():
        columns |= columns_of(f"{name}/{key}", part, [value[key] for value in values])
    return columns


def tree_of(name: str, columns: Mapping[str, npt.NDArray[Any]]) -> Any:
    """The array ``name``, or the dict of what :func:`columns_of` made ``name/key`` of.

    Raises:
        KeyError: there is neither.
    """
    if name in columns:
        return columns[name]
    inner = f"{name}/"
    keys = {column.removeprefix(inner).partition("/")[0] for column in columns if inner in column}
    if not keys:
        raise KeyError(name)
    return {key: tree_of(inner + key, columns) for key in sorted(keys)}
