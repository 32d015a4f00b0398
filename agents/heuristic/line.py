"""The centre line of the road ahead, put together from the observed track segments."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["CentreLine"]

FloatArray = npt.NDArray[np.float64]

#: Segments looked at; the shortest ones of all tracks make 100 m with 50, twice that at forks.
_MAX_SEGMENTS = 96
#: On most tracks these are enough.
_FEW_SEGMENTS = 32

#: Nothing farther away is of use [m]; but a few segments must be left.
_REACH = 110.0
_MIN_SEGMENTS = 4

#: Segments of one branch touch; entering and leaving a side branch is a jump [m].
_TOUCHING = 0.3

#: No jump is longer than this [m]; where one would be, the line ends.
_LONGEST_JUMP = 25.0

#: Beyond its last point the line goes straight on so far [m].
_TAIL = 150.0


@dataclass(frozen=True, slots=True)
class CentreLine:
    """The middle of the road ahead in the kart frame (x right, y up, z forward).

    Attributes:
        points: ``(P, 3)`` float64 [m], in driving order; the last one lies far beyond the
            road that is known, straight on.
        marks: ``(P,)`` length of the line up to each point [m]; 0 is beside the kart, and
            what lies behind it is negative.
        half_widths: ``(P,)`` distance from the line to the road's edge [m].
    """

    points: FloatArray
    marks: FloatArray
    half_widths: FloatArray

    @classmethod
    def of(cls, observation: Mapping[str, Any]) -> CentreLine:
        """The line of an observation of the ``full`` view.

        At a fork it keeps to the branch whose segments touch, which is the main road, or
        the side road that the kart is in.
        """
        starts = _near_starts(observation["paths_start"])
        ends = _vectors(observation["paths_end"][: len(starts)], 3)
        widths = _vectors(observation["paths_width"][: len(starts)], 1)[:, 0]
        chain = _touching_chain(starts, ends)
        points = np.stack([starts[chain], ends[chain]], axis=1).reshape(-1, 3)
        points = np.concatenate([points, _tail(points)])
        steps = points[1:] - points[:-1]
        lengths = np.sqrt((steps * steps).sum(axis=1))
        marks = np.zeros(len(points))
        np.cumsum(lengths, out=marks[1:])
        marks -= _share_passed(points) * lengths[0]
        half_widths = np.repeat(widths[chain] / 2, 2)
        return cls(points, marks, np.append(half_widths, half_widths[-1]))

    def at(self, marks: FloatArray) -> FloatArray:
        """Points ``(M, 3)`` [m] of the line at some marks ``(M,)`` [m]."""
        columns = [np.interp(marks, self.marks, column) for column in self.points.T]
        return np.stack(columns, axis=1)

    def half_width_at(self, marks: FloatArray) -> FloatArray:
        """Distance to the road's edge ``(M,)`` [m] at some marks ``(M,)`` [m]."""
        return np.interp(marks, self.marks, self.half_widths)


def _vectors(sequence: Any, size: int) -> FloatArray:
    return np.concatenate(sequence, dtype=np.float64).reshape(-1, size)


def _near_starts(segments: Any) -> FloatArray:
    """Where those segments begin that come before the road first leaves the neighbourhood."""
    for count in (_FEW_SEGMENTS, _MAX_SEGMENTS):
        starts = _vectors(segments[:count], 3)
        is_far = (starts * starts).sum(axis=1) > _REACH**2
        if is_far.any():
            return starts[: max(int(is_far.argmax()), _MIN_SEGMENTS)]
        if len(starts) < count:
            break
    return starts


def _tail(points: FloatArray) -> FloatArray:
    """A point ``(1, 3)`` far beyond the end of the line."""
    last = points[-1] - points[-2]
    return np.asarray(points[-1:] + last * (_TAIL / max(math.hypot(*last), 1e-3)))


def _share_passed(points: FloatArray) -> float:
    """How much of the first segment lies behind the kart, which is at the origin."""
    along = points[1] - points[0]
    return float(np.clip(-points[0] @ along / max(along @ along, 1e-9), 0.0, 1.0))


def _touching_chain(starts: FloatArray, ends: FloatArray) -> npt.NDArray[np.intp]:
    """Indices of the segments that follow one another, beginning with the first."""
    count = len(starts)
    jumps = np.abs(starts[1:] - ends[:-1]).max(axis=1) if count > 1 else np.zeros(0)
    if (jumps < _TOUCHING).all():
        return np.arange(count)
    offsets = starts[None, :, :] - ends[:, None, :]
    distances = np.abs(offsets).sum(axis=2)
    distances[np.tri(count, dtype=bool)] = np.inf  # what follows comes later in driving order
    followers = distances.argmin(axis=1).tolist()
    is_last = (distances.min(axis=1) > _LONGEST_JUMP).tolist()
    chain = [0]
    while not is_last[chain[-1]]:
        chain.append(followers[chain[-1]])
    return np.array(chain, np.intp)
