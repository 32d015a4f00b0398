"""Frames: from the world to each kart's own view of it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]


#: The entries of the matrix as sums of products of a quaternion's parts.
_ENTRIES = (
    *("+ww+xx-yy-zz", "+xy+xy-wz-wz", "+xz+xz+wy+wy"),
    *("+xy+xy+wz+wz", "+ww-xx+yy-zz", "+yz+yz-wx-wx"),
    *("+xz+xz-wy-wy", "+yz+yz+wx+wx", "+ww-xx-yy+zz"),
)


def _product_weights() -> FloatArray:
    """``(16, 9)``: how the matrix's entries are made of the products of w, x, y, z."""
    weights = np.zeros((4, 4, 9), np.float32)
    for column, entry in enumerate(_ENTRIES):
        for sign, first, second in zip(entry[::3], entry[1::3], entry[2::3], strict=True):
            weights["wxyz".index(first), "wxyz".index(second), column] += float(f"{sign}1")
    return weights.reshape(16, 9)


_FROM_PRODUCTS = _product_weights()


def rotation_matrices(quaternions: FloatArray) -> FloatArray:
    """Matrices of the quaternions ``(..., 4)`` in the order w, x, y, z.

    The usual formula (`q v q*` written out for a unit quaternion). For the engine's
    kart rotations the matrix applied to (point - kart location) gives the kart frame.

    Returns:
        ``(..., 3, 3)`` of the same type.
    """
    products = quaternions[..., :, None] * quaternions[..., None, :]
    flat = products.reshape(*quaternions.shape[:-1], 16)
    matrices: FloatArray = flat @ _FROM_PRODUCTS.astype(quaternions.dtype, copy=False)
    return matrices.reshape(*quaternions.shape[:-1], 3, 3)


def to_kart_frame(points: FloatArray, locations: FloatArray, matrices: FloatArray) -> FloatArray:
    """Points as the karts see them: x right, y up, z forward [m].

    Args:
        points: ``(A, M, 3)`` or ``(1, M, 3)`` [m], world frame.
        locations: ``(A, 3)`` of the karts [m], world frame.
        matrices: ``(A, 3, 3)`` from :func:`rotation_matrices`.

    Returns:
        ``(A, M, 3)`` float32.
    """
    seen: FloatArray = np.matmul(points - locations[:, None], matrices.transpose(0, 2, 1))
    return seen


def squared(vectors: FloatArray) -> FloatArray:
    """The squared lengths ``(...)`` of ``(..., 3)``, quicker than by a sum."""
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    squares: FloatArray = x * x + y * y + z * z
    return squares


def to_polar(positions: FloatArray) -> FloatArray:
    """``(..., 3)`` positions [m] as two angles [rad] and a distance [m]."""
    x, y, z = positions[..., 0], positions[..., 1], positions[..., 2]
    polar = np.empty_like(positions)
    polar[..., 0] = np.arctan2(x, z)
    polar[..., 1] = np.arctan2(y, z)
    polar[..., 2] = np.linalg.norm(positions, axis=-1)
    return polar
