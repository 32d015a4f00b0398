"""The marks at which the planner observes the road ahead."""

from __future__ import annotations

import numpy as np

from .arrays import FloatArray

#: Number of marks along the road, starting at the kart, and their spacing [m].
MARK_COUNT, MARK_SPACING = 36, 3.0
LINE_MARKS = (MARK_SPACING * np.arange(MARK_COUNT + 1)).astype(np.float32)


def headings_of(line: FloatArray) -> FloatArray:
    """Returns the direction of a road after each mark but the last, relative to the kart's [rad].

    Args:
        line: ``(A, M + 1, 4)`` marks in the kart's frame, and half widths [m].
    """
    steps = line[:, 1:, ::2] - line[:, :-1, ::2]
    headings: FloatArray = np.arctan2(steps[..., 0], steps[..., 1])
    return headings
