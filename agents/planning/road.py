"""The road ahead and the nearest karts, as the planner observes them.

Observations have no speeds of other karts. A :class:`RivalTracker` keeps what a kart observed in
the previous step, from which the extension computes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stkzoo.kernel import to_polar

from . import FloatArray, IntArray

#: Number of marks along the road, starting at the kart, and their spacing [m].
MARK_COUNT, MARK_SPACING = 36, 3.0
LINE_MARKS = (MARK_SPACING * np.arange(MARK_COUNT + 1)).astype(np.float32)

#: Columns of a road with half widths: the point, and the half width for each side.
_COLUMNS = np.array([0, 1, 2, 3, 3])

#: Number of nearest karts to track, and their maximum distance [m].
RIVALS, REACH = 4, 25.0
#: A match that implies a higher speed is rejected [m/s].
FASTEST = 50.0
#: Position of a missing kart [m].
NOWHERE = 1e3
#: Largest rotation in a step [rad]; a larger one is due to a change of the road.
MOST_TURNED = 0.6

#: Signs of a policy's inputs from the nearest karts in a mirrored race.
RIVALS_MIRROR = np.tile(np.array([1, 1, -1, 1, -1], np.float32), RIVALS)


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
    steps = line[:, 1:, :3] - line[:, :-1, :3]
    # The bits of numpy.arctan2 depend on the processor.
    return np.ascontiguousarray(to_polar(steps)[..., 0])


class RivalMoment(NamedTuple):
    """Observations of A karts at one moment.

    Attributes:
        spots: ``(A, RIVALS, 2)`` positions of the nearest karts, right and ahead [m].
        velocity: ``(A, 2)`` velocity of the observing kart, right and ahead [m/s].
        headings: ``(A, 36)`` directions of the road ahead [rad].
    """

    spots: FloatArray
    velocity: FloatArray
    headings: FloatArray

    @classmethod
    def unknown(cls, count: int) -> RivalMoment:
        """Returns the moment of karts that have observed nothing."""
        return cls(
            np.full((count, RIVALS, 2), NOWHERE, np.float32),
            np.zeros((count, 2), np.float32),
            np.zeros((count, MARK_COUNT), np.float32),
        )


class RivalTracker:
    """Observations of A karts in this step and in the step before.

    Args:
        count: number of karts, A.
    """

    def __init__(self, count: int) -> None:
        self.now = RivalMoment.unknown(count)
        self.before = self.now

    @classmethod
    def joined(cls, trackers: Sequence[RivalTracker]) -> RivalTracker:
        """Returns a joint tracker of several trackers for one step."""
        joined = cls(0)
        columns = zip(*(tracker.now for tracker in trackers), strict=True)
        joined.now = RivalMoment(*map(np.concatenate, columns))
        return joined

    def take(self, joined: RivalTracker, rows: slice) -> None:
        """Copies the observations of some karts from a joint tracker."""
        self.before, self.now = (
            RivalMoment(*(array[rows] for array in moment))
            for moment in (joined.before, joined.now)
        )

    def look(self) -> None:
        """Advances the tracker by one step."""
        self.before = self.now

    def forget(self, rows: IntArray) -> None:
        """Resets some karts."""
        nothing = RivalMoment.unknown(len(rows))
        for moment in (self.before, self.now):
            for array, empty in zip(moment, nothing, strict=True):
                array[rows] = empty
