"""Lengths of vectors, and places on a line of points."""

from __future__ import annotations

import numpy as np


def squared(vectors):
    """Returns the squared lengths ``(...)`` of vectors ``(..., 3)``; faster than ``np.sum``."""
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return x * x + y * y + z * z


def line_places(starts, along, looks, spacing, num_points):
    """Returns the positions on a kart's line at given distances ahead.

    Args:
        starts: ``(A, 3)`` starts of the karts' own segments [m], in frames with the kart at the
            origin.
        along: ``(A, 3)`` vectors from there to the segments' ends [m].
        looks: ``(L,)`` distances ahead of the kart [m].
        spacing: distance between the line's points [m].
        num_points: number of these points.

    Returns:
        ``(A, L)`` each: index of the preceding point, and fraction of the way to the next one.
    """
    squares = squared(along)
    share = -(starts * along).sum(-1) / np.where(squares > 0, squares, 1)
    passed = np.clip(share, 0, 1) * np.sqrt(squares)
    places = (passed[:, None] + looks) / np.float32(spacing)
    before = np.minimum(places.astype(np.intp), num_points - 2)
    return before, (places - before).astype(np.float32)
