"""The marks at which the planner observes the road ahead."""

from __future__ import annotations

import numpy as np

from .arrays import FloatArray

#: Number of marks along the road, starting at the kart, and their spacing [m].
MARK_COUNT, MARK_SPACING = 36, 3.0
LINE_MARKS = (MARK_SPACING * np.arange(MARK_COUNT + 1)).astype(np.float32)

#: Columns of a road with half widths: the point, and the half width for each side.
_COLUMNS = np.array([0, 1, 2, 3, 3])


def line_of(road: FloatArray) -> FloatArray:
    """Returns the line of a road with equal distances to its left and to its right edge.

    Args:
        road: ``(A, N, 4)`` points in the kart's frame, and half widths [m]; the marks come last.

    Returns:
        ``(A, M + 1, 5)`` marks, and distances to the left and to the right edge [m].
    """
    # numpy is slower in its default mode
    line: FloatArray = road[:, -len(LINE_MARKS) :].take(_COLUMNS, axis=2, mode="clip")
    return line


def headings_of(line: FloatArray) -> FloatArray:
    """Returns the direction of a road after each mark but the last, relative to the kart's [rad].

    Args:
        line: ``(A, M + 1, 4)`` or ``(A, M + 1, 5)``, beginning with the marks in the kart's frame
            [m].
    """
    steps = line[:, 1:, ::2] - line[:, :-1, ::2]
    headings: FloatArray = np.arctan2(steps[..., 0], steps[..., 1])
    return headings
