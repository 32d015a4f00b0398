"""The road ahead of any number of karts, in its own coordinates: along it, and across."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stkzoo.mdp import squared

from .arrays import FloatArray

#: The road is known at so many marks, from the kart on, so far apart [m].
MARK_COUNT, MARK_SPACING = 36, 3.0
LINE_MARKS = (MARK_SPACING * np.arange(MARK_COUNT + 1)).astype(np.float32)

#: A kart's turn is measured at so many marks; a larger one is a change of the road [rad].
_TURN_MARKS, _MOST_TURNED = 9, 0.6


@dataclass(frozen=True, slots=True)
class RoadPlaces:
    """Where spots are, ``(A, I)`` each.

    Attributes:
        along: how far ahead along the road [m].
        across: how far to the right of its middle [m].
        above: how far above it [m].
        half_widths: the road's, there [m].
        headings: its direction there, 0 is the kart's, positive to the right [rad].
    """

    along: FloatArray
    across: FloatArray
    above: FloatArray
    half_widths: FloatArray
    headings: FloatArray


@dataclass(frozen=True, slots=True)
class RoadAhead:
    """The road ahead of A karts.

    Attributes:
        points: ``(A, 36, 3)``: the marks in the kart's frame [m].
        headings: ``(A, 36)`` direction of the road from each on, 0 is the kart's [rad].
        curvature: ``(A, 36)`` [1/m].
        half_widths: ``(A, 36)`` [m].
        offset: ``(A,)`` how far the kart is to the right of the middle [m].
        angle: ``(A,)`` the kart's direction, 0 is the road's [rad].
    """

    points: FloatArray
    headings: FloatArray
    curvature: FloatArray
    half_widths: FloatArray
    offset: FloatArray
    angle: FloatArray

    @classmethod
    def of(cls, line: FloatArray) -> RoadAhead:
        """The road of a line ``(A, 37, 4)``: :data:`LINE_MARKS` in the kart's frame, half width."""
        points = line[..., :3]
        steps = points[:, 1:] - points[:, :-1]
        headings = np.arctan2(steps[..., 0], steps[..., 2])
        turns = headings[:, 1:] - headings[:, :-1]
        if (np.abs(turns) >= np.pi).any():
            headings = np.unwrap(headings, axis=1)
            turns = headings[:, 1:] - headings[:, :-1]
        curvature = np.zeros_like(headings)
        curvature[:, :-1] = turns
        curvature[:, 1:-1] += turns[:, :-1]
        curvature[:, 1:-1] /= 2
        curvature /= MARK_SPACING
        own = headings[:, 0]
        x, z = points[:, 0, 0], points[:, 0, 2]
        offset = z * np.sin(own) - x * np.cos(own)
        return cls(points[:, :-1], headings, curvature, line[:, :-1, 3], offset, -own)

    def bends(self, lengths: FloatArray) -> FloatArray:
        """Mean curvature ``(A, 36)`` [1/m] over lengths ``(A,)`` [m] from each mark on."""
        ahead = (lengths / MARK_SPACING).astype(np.intp)
        ahead = np.minimum(np.maximum(ahead, 1), MARK_COUNT - 1)[:, None]
        marks = np.arange(MARK_COUNT) + ahead
        rows = np.arange(len(marks))[:, None]
        there = self.headings[rows, np.minimum(marks, MARK_COUNT - 1)]
        return np.where(marks < MARK_COUNT, (there - self.headings) / (ahead * MARK_SPACING), 0)

    def straightness(self, lengths: FloatArray) -> FloatArray:
        """By how much the road turns at most over lengths ``(A,)`` [m] from the kart on [rad]."""
        count = np.maximum((lengths / MARK_SPACING).astype(np.intp), 1)[:, None]
        turned = np.abs(self.headings - self.headings[:, :1])
        straightness: FloatArray = np.where(np.arange(MARK_COUNT) < count, turned, 0).max(axis=1)
        return straightness

    def turned_since(self, before: FloatArray, way: FloatArray) -> FloatArray:
        """By how much karts have turned to the right since the road ahead was another, ``(A,)``.

        The road stays where it is: what is seen of it turns to the left when a kart turns.

        Args:
            before: ``(A, 36)``: :attr:`headings` then; not finite where it is not known.
            way: ``(A,)`` how far they have driven since [m].
        """
        place = np.arange(_TURN_MARKS) + np.minimum(way / MARK_SPACING, 1)[:, None]
        mark = place.astype(np.intp)
        share = place - mark
        rows = np.arange(len(before))[:, None]
        then = before[rows, mark] * (1 - share) + before[rows, mark + 1] * share
        turns = np.sort(then - self.headings[:, :_TURN_MARKS], axis=1)
        turned = turns[:, _TURN_MARKS // 2]  # the median
        turned = (turned + np.pi) % (2 * np.pi) - np.pi
        return np.where(np.abs(turned) < _MOST_TURNED, turned, 0).astype(np.float32)

    def place(self, spots: FloatArray) -> RoadPlaces:
        """Where spots ``(A, I, 3)`` in the kart's frame are."""
        # of |point - spot|² what differs from point to point
        apart = squared(self.points)[:, None] - 2.0 * (spots @ self.points.transpose(0, 2, 1))
        nearest = apart.argmin(-1)
        rows = np.arange(len(spots))[:, None]
        apart = spots - self.points[rows, nearest]
        x, y, z = apart[..., 0], apart[..., 1], apart[..., 2]
        heading = self.headings[rows, nearest]
        sines, cosines = np.sin(heading), np.cos(heading)
        along = nearest * np.float32(MARK_SPACING) + x * sines + z * cosines
        marks = (along / MARK_SPACING).astype(np.intp)
        marks = np.minimum(np.maximum(marks, 0), MARK_COUNT - 1)
        return RoadPlaces(along, x * cosines - z * sines, y, self.half_widths[rows, marks], heading)
