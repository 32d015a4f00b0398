"""A track's road as outlines, seen from above."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from stkzoo.engine.track import TrackMap

__all__ = ["Road", "road_of"]

FloatArray = npt.NDArray[np.float32]

#: Ends of segments that lie nearer than this are drawn as one place [m].
_JOINT = 16.0
#: No road is drawn narrower or wider than this [m].
_WIDTHS = 3.0, 60.0


class Road:
    """The driving line's segments as four-sided pieces. Points are ``(x, z)`` [m].

    Attributes:
        quads: ``(N, 4, 2)``: left and right edge at a piece's start, right and left at its end.
        joints: ``(N, 2)``: the centre at each piece's start.
        widths: ``(N,)`` [m].
        heights: ``(N,)`` [m], at each piece's middle.
        order: ``(N,)``: the pieces from the lowest to the highest.
        low, high: ``(2,)``: the corners of the box that holds all pieces.
        line: ``(2, 2)``: the start line, from left to right.
        forward: ``(2,)``: the direction of driving there.
    """

    def __init__(self, track: TrackMap) -> None:
        starts, ends = track.path_nodes[:, 0, ::2], track.path_nodes[:, 1, ::2]
        self.widths = np.clip(track.path_width[:, 0], *_WIDTHS)
        self.heights = track.path_nodes[:, :, 1].mean(1)
        self.joints = starts
        ways = _unit(ends - starts)
        at_start = _mean_ways(ways, track)
        side = _right_of(at_start) * self.widths[:, None] / 2
        left, right = starts - side, starts + side
        far = _right_of(ways) * self.widths[:, None] / 2
        far_left, far_right = ends - far, ends + far
        for node, followers in enumerate(track.successors):
            if followers:
                gaps = np.linalg.norm(starts[list(followers)] - ends[node], axis=1)
                nearest = followers[int(np.argmin(gaps))]
                if gaps.min() < _JOINT:
                    far_left[node], far_right[node] = left[nearest], right[nearest]
        self.quads = np.stack([left, right, far_right, far_left], axis=1)
        self.order = np.argsort(self.heights, kind="stable")
        corners = self.quads.reshape(-1, 2)
        self.low, self.high = corners.min(0), corners.max(0)
        first = int(np.argmin(track.path_distance[:, 0]))
        self.line = np.stack([left[first], right[first]])
        self.forward = at_start[first]

    def shades(self) -> FloatArray:
        """``(N,)``: 0 for the lowest, 1 for the highest piece; flat tracks are all 0.5."""
        low, high = float(self.heights.min()), float(self.heights.max())
        if high - low < 2.0:
            return np.full(len(self.heights), 0.5, np.float32)
        return np.asarray((self.heights - low) / (high - low), np.float32)

    def near(self, centre: FloatArray, reach: float) -> npt.NDArray[np.bool_]:
        """``(N,)``: which pieces come within so many metres of a place, in ``x`` or ``z``."""
        low, high = self.quads.min(1), self.quads.max(1)
        near: npt.NDArray[np.bool_] = ((low < centre + reach) & (high > centre - reach)).all(1)
        return near


@lru_cache(maxsize=32)
def road_of(track: TrackMap) -> Road:
    """The road of a track; the same object every time."""
    return Road(track)


def _mean_ways(ways: FloatArray, track: TrackMap) -> FloatArray:
    """Directions where segments meet: the mean of a segment's and its forerunners'."""
    sums = ways.copy()
    for node, followers in enumerate(track.successors):
        for follower in followers:
            if float(ways[node] @ ways[follower]) > 0:
                sums[follower] += ways[node]
    return _unit(sums)


def _unit(vectors: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-6), np.float32)


def _right_of(ways: FloatArray) -> FloatArray:
    """Driving along z, x is on the right."""
    return np.stack([ways[:, 1], -ways[:, 0]], axis=1)
