"""Names of ``pystk2_gymnasium.utils``."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.mdp.geometry import rotation_matrices
from stkzoo.wrappers import Discretizer

__all__ = ["Discretizer", "max_enum_value", "rotate", "rotate_batch"]

FloatArray = npt.NDArray[np.floating[Any]]


def rotate(v: FloatArray, q: FloatArray) -> FloatArray:
    """The vector ``v`` (3,) turned by the unit quaternion ``q`` (4,): w, x, y, z."""
    turned: FloatArray = rotate_batch(np.asarray(v)[None], q)[0]
    return turned


def rotate_batch(vectors: FloatArray, q: FloatArray) -> FloatArray:
    """The vectors (N, 3) turned by the unit quaternion ``q`` (4,): w, x, y, z."""
    matrix = rotation_matrices(np.asarray(q))
    turned: FloatArray = (np.asarray(vectors) @ matrix.T).astype(vectors.dtype)
    return turned


def max_enum_value(EnumType: Any) -> int:  # noqa: N803 - the reference's argument
    """One more than the largest number of an enumeration, or of a class's ``Type``."""
    members = getattr(EnumType, "Type", EnumType).__members__
    return max(int(member.value) for member in members.values()) + 1
