"""Transformations from the world frame to the frames of karts."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]


#: The entries of the rotation matrix as sums of products of quaternion components.
_ENTRIES = (
    *("+ww+xx-yy-zz", "+xy+xy-wz-wz", "+xz+xz+wy+wy"),
    *("+xy+xy+wz+wz", "+ww-xx+yy-zz", "+yz+yz-wx-wx"),
    *("+xz+xz-wy-wy", "+yz+yz+wx+wx", "+ww-xx-yy+zz"),
)


def _product_weights() -> FloatArray:
    """Returns the weights ``(16, 9)`` of the products of w, x, y, z in the matrix entries."""
    weights = np.zeros((4, 4, 9), np.float32)
    for column, entry in enumerate(_ENTRIES):
        for sign, first, second in zip(entry[::3], entry[1::3], entry[2::3], strict=True):
            weights["wxyz".index(first), "wxyz".index(second), column] += float(f"{sign}1")
    return weights.reshape(16, 9)


_FROM_PRODUCTS = _product_weights()


def rotation_matrices(quaternions: FloatArray) -> FloatArray:
    """Converts quaternions ``(..., 4)`` in the order w, x, y, z to rotation matrices.

    The formula is the usual expansion of `q v q*` for a unit quaternion. For the engine's kart
    rotations, the matrix maps (point - kart location) to the kart frame.

    Args:
        quaternions: ``(..., 4)`` floats.

    Returns:
        ``(..., 3, 3)`` of the same dtype.
    """
    products = quaternions[..., :, None] * quaternions[..., None, :]
    flat = products.reshape(*quaternions.shape[:-1], 16)
    matrices: FloatArray = flat @ _FROM_PRODUCTS.astype(quaternions.dtype, copy=False)
    return matrices.reshape(*quaternions.shape[:-1], 3, 3)


def to_kart_frame(points: FloatArray, locations: FloatArray, matrices: FloatArray) -> FloatArray:
    """Transforms points to the frame of each kart: x right, y up, z forward [m].

    Args:
        points: ``(A, M, 3)`` or ``(1, M, 3)`` points in the world frame [m].
        locations: ``(A, 3)`` locations of the karts in the world frame [m].
        matrices: ``(A, 3, 3)`` from :func:`rotation_matrices`.

    Returns:
        ``(A, M, 3)`` float32 [m].
    """
    seen: FloatArray = np.matmul(points - locations[:, None], matrices.transpose(0, 2, 1))
    return seen
