"""The road ahead of any number of karts, in coordinates along and across it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tests.oracle.vectors import squared

FloatArray = npt.NDArray[np.float32]

#: Number of marks that measure a kart's rotation.
_TURN_MARKS = 9


@dataclass(frozen=True, slots=True)
class RoadPlaces:
    """Positions relative to the road, ``(A, I)`` each.

    Attributes:
        along: distance ahead along the road [m].
        across: offset from its middle, positive to the right [m].
        above: height above it [m].
        left: distance from the middle to the left edge at that point [m].
        right: distance from the middle to the right edge at that point [m].
        headings: direction of the road at that point, relative to the kart's, positive to the right
            [rad].
    """

    along: npt.NDArray[np.float64]
    across: FloatArray
    above: FloatArray
    left: FloatArray
    right: FloatArray
    headings: FloatArray


@dataclass(frozen=True, slots=True)
class RoadAhead:
    """The road ahead of A karts, at M marks.

    Attributes:
        points: ``(A, M, 3)`` marks in the kart's frame [m].
        headings: ``(A, M)`` direction of the road after each mark, relative to the kart's [rad].
        curvature: ``(A, M)`` [1/m].
        left: ``(A, M)`` distance from the middle to the left edge [m].
        right: ``(A, M)`` distance from the middle to the right edge [m].
        offset: ``(A,)`` offset of the kart from the middle, positive to the right [m].
        angle: ``(A,)`` direction of the kart relative to the road's [rad].
        spacing: distance between two marks [m].
    """

    points: FloatArray
    headings: FloatArray
    curvature: FloatArray
    left: FloatArray
    right: FloatArray
    offset: FloatArray
    angle: FloatArray
    spacing: float

    @classmethod
    def of(cls, line: FloatArray, headings: FloatArray, spacing: float) -> RoadAhead:
        """Returns the road of a line.

        Args:
            line: ``(A, M + 1, 5)`` marks, and distances to the left and to the right edge [m].
            headings: ``(A, M)`` direction of the road after each mark, from -pi to pi [rad].
            spacing: distance between two marks [m].
        """
        points = line[:, :-1, :3]
        turns = headings[:, 1:] - headings[:, :-1]
        if (np.abs(turns) >= np.pi).any():
            headings = np.unwrap(headings, axis=1)
            turns = headings[:, 1:] - headings[:, :-1]
        curvature = np.zeros_like(headings)
        curvature[:, :-1] = turns
        curvature[:, 1:-1] += turns[:, :-1]
        curvature[:, 1:-1] /= 2
        curvature /= spacing
        own = headings[:, 0]
        x, z = points[:, 0, 0], points[:, 0, 2]
        offset = z * np.sin(own) - x * np.cos(own)
        left, right = line[:, :-1, 3], line[:, :-1, 4]
        return cls(points, headings, curvature, left, right, offset, -own, spacing)

    def bends(self, lengths: FloatArray) -> npt.NDArray[np.float64]:
        """Returns mean curvatures ``(A, M)`` [1/m] over lengths ``(A,)`` [m] after each mark."""
        count = self.headings.shape[1]
        ahead = (lengths / self.spacing).astype(np.intp)
        ahead = np.minimum(np.maximum(ahead, 1), count - 1)[:, None]
        marks = np.arange(count) + ahead
        rows = np.arange(len(marks))[:, None]
        there = self.headings[rows, np.minimum(marks, count - 1)]
        return np.where(marks < count, (there - self.headings) / (ahead * self.spacing), 0)

    def straightness(self, lengths: FloatArray) -> FloatArray:
        """Returns the largest turn of the road within lengths ``(A,)`` [m] from the kart [rad]."""
        count = np.maximum((lengths / self.spacing).astype(np.intp), 1)[:, None]
        turned = np.abs(self.headings - self.headings[:, :1])
        is_within = np.arange(turned.shape[1]) < count
        straightness: FloatArray = np.where(is_within, turned, 0).max(axis=1)
        return straightness

    def turned_since(self, before: FloatArray, way: FloatArray, most: float) -> FloatArray:
        """Returns the rotation of karts to the right since an earlier observation, ``(A,)`` [rad].

        The road itself is fixed, so its headings change to the left when a kart turns right.

        Args:
            before: ``(A, M)`` earlier :attr:`headings`; not finite if unknown.
            way: ``(A,)`` distance driven since then [m].
            most: largest rotation [rad]; a larger one is due to a change of the road.
        """
        place = np.arange(_TURN_MARKS) + np.minimum(way / self.spacing, 1)[:, None]
        mark = place.astype(np.intp)
        share = place - mark
        rows = np.arange(len(before))[:, None]
        then = before[rows, mark] * (1 - share) + before[rows, mark + 1] * share
        turns = np.sort(then - self.headings[:, :_TURN_MARKS], axis=1)
        turned = turns[:, _TURN_MARKS // 2]  # the median
        turned = (turned + np.pi) % (2 * np.pi) - np.pi
        return np.where(np.abs(turned) < most, turned, 0).astype(np.float32)

    def place(self, spots: FloatArray) -> RoadPlaces:
        """Locates spots ``(A, I, 3)`` in the kart's frame [m] relative to the road."""
        # |point - spot|² without the constant term |spot|²
        apart = squared(self.points)[:, None] - 2.0 * (spots @ self.points.transpose(0, 2, 1))
        nearest = apart.argmin(-1)
        rows = np.arange(len(spots))[:, None]
        apart = spots - self.points[rows, nearest]
        x, y, z = apart[..., 0], apart[..., 1], apart[..., 2]
        heading = self.headings[rows, nearest]
        sines, cosines = np.sin(heading), np.cos(heading)
        along = nearest * np.float64(self.spacing) + x * sines + z * cosines
        marks = (along / self.spacing).astype(np.intp)
        marks = np.minimum(np.maximum(marks, 0), self.headings.shape[1] - 1)
        left, right = self.left[rows, marks], self.right[rows, marks]
        return RoadPlaces(along, x * cosines - z * sines, y, left, right, heading)
