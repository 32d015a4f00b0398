"""Frames: from the world to each kart's own view of it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["rotation_matrices", "to_kart_frame"]

FloatArray = npt.NDArray[np.float32]


def rotation_matrices(quaternions: FloatArray) -> FloatArray:
    """Matrices of the quaternions ``(..., 4)`` in the order w, x, y, z.

    The usual formula (`q v q*` written out for a unit quaternion). For the engine's
    kart rotations the matrix applied to (point - kart location) gives the kart frame.

    Returns:
        ``(..., 3, 3)`` of the same type.
    """
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    matrices = np.empty((*quaternions.shape[:-1], 3, 3), quaternions.dtype)
    matrices[..., 0, 0] = w * w + x * x - y * y - z * z
    matrices[..., 0, 1] = 2 * (x * y - w * z)
    matrices[..., 0, 2] = 2 * (x * z + w * y)
    matrices[..., 1, 0] = 2 * (x * y + w * z)
    matrices[..., 1, 1] = w * w - x * x + y * y - z * z
    matrices[..., 1, 2] = 2 * (y * z - w * x)
    matrices[..., 2, 0] = 2 * (x * z - w * y)
    matrices[..., 2, 1] = 2 * (y * z + w * x)
    matrices[..., 2, 2] = w * w - x * x - y * y + z * z
    return matrices


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
