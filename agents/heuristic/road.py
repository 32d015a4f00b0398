"""The road ahead in its own coordinates: along its middle, and across it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .line import CentreLine

__all__ = ["COUNT", "SPACING", "Road"]

FloatArray = npt.NDArray[np.float64]

#: The road is known at so many marks, from the kart on, so far apart [m].
COUNT, SPACING = 36, 3.0
_MARKS: FloatArray = np.arange(COUNT + 1, dtype=np.float64) * np.float64(SPACING)


@dataclass(frozen=True, slots=True)
class Road:
    """The road ahead, at marks ``SPACING`` apart. Right is positive.

    Attributes:
        points: ``(COUNT, 3)`` middle of the road, kart frame [m].
        headings: ``(COUNT,)`` its direction, 0 is the kart's [rad].
        curvature: ``(COUNT,)`` [1/m].
        half_widths: ``(COUNT,)`` from the middle to the edge [m].
        offset: how far the kart is from the middle [m].
        angle: the kart's direction, 0 is the road's [rad].
    """

    points: FloatArray
    headings: FloatArray
    curvature: FloatArray
    half_widths: FloatArray
    offset: float
    angle: float

    @classmethod
    def of(cls, line: CentreLine) -> Road:
        """The road around a centre line."""
        points = line.at(_MARKS)
        steps = points[1:] - points[:-1]
        headings = np.unwrap(np.arctan2(steps[:, 0], steps[:, 2]))
        turns = headings[1:] - headings[:-1]
        curvature = np.zeros(COUNT)
        curvature[:-1] = turns
        curvature[1:-1] += turns[:-1]
        curvature[1:-1] /= 2
        curvature /= SPACING
        own = float(headings[0])
        x, _, z = points[0].tolist()
        offset = z * math.sin(own) - x * math.cos(own)
        half_widths = line.half_width_at(_MARKS[:-1])
        return cls(points[:-1], headings, curvature, half_widths, offset, -own)

    def bends(self, length: float) -> FloatArray:
        """Mean curvature ``(COUNT,)`` [1/m] over a length [m] from each mark on."""
        ahead = min(max(int(length / SPACING), 1), COUNT - 1)
        bends = np.zeros(COUNT)
        bends[:-ahead] = (self.headings[ahead:] - self.headings[:-ahead]) / (ahead * SPACING)
        return bends

    def straightness(self, length: float) -> float:
        """By how much the road turns at most over a length [m] from the kart on [rad]."""
        ahead = self.headings[: max(int(length / SPACING), 1)]
        return float(np.abs(ahead - self.headings[0]).max())

    def place(self, spots: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Where spots ``(M, 3)`` of the kart frame are on the road.

        Returns:
            Along the road, across it, and above it, ``(M,)`` each [m].
        """
        deltas = spots[:, None, :] - self.points
        nearest = (deltas * deltas).sum(axis=2).argmin(axis=1)
        x, y, z = deltas[np.arange(len(spots)), nearest].T
        sines, cosines = np.sin(self.headings[nearest]), np.cos(self.headings[nearest])
        return nearest * SPACING + x * sines + z * cosines, x * cosines - z * sines, y
