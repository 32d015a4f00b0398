"""The road ahead as a line of even steps, put together from track segments.

The line begins where the kart's own segment begins and runs along the segments that follow one
another. At a fork it keeps to the branch whose segments touch: the main road, or the side road
that the kart is in. Its points are :data:`STEP` metres apart, whatever the segments' lengths.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from stkzoo.mdp.geometry import squared

if TYPE_CHECKING:
    from stkzoo.engine.track import TrackMap

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[Any]

#: Segments looked at; the shortest ones of all tracks make 100 m with 50, twice that at forks.
MAX_SEGMENTS = 96

#: Distance between the line's points [m].
STEP = 2.0

#: Points of a line.
NUM_POINTS = 66

#: Segments of one branch touch; entering and leaving a side branch is a jump [m].
_TOUCHING = 0.3

#: No jump is longer than this [m]; where one would be, the line ends.
_LONGEST_JUMP = 25.0

#: Beyond its last point a line goes straight on so far [m].
_TAIL = 150.0

#: Where the road ahead is looked at, from the kart on along the line [m].
MARKS = np.array([3, 6, 10, 14, 19, 25, 32, 40, 50, 62, 76, 92], np.float32)

#: Where it is looked at in all: beside the kart and at the marks; and a little farther, for its
#: heading [m].
BEYOND = 3.0
LOOKS = np.concatenate([[0.0], MARKS, MARKS + BEYOND]).astype(np.float32)

#: ``lines``, ``starts`` and ``along`` of a :class:`RoadTable`.
RoadArrays: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]

_POINTS = STEP * np.arange(NUM_POINTS)


def road_line(starts: FloatArray, ends: FloatArray, widths: FloatArray) -> FloatArray:
    """The line ahead of the first of some segments.

    Args:
        starts: ``(P, 3)`` [m], in any frame: the nearest :data:`MAX_SEGMENTS` segments, nearest
            first along the way a kart can drive, the kart's own before all others.
        ends: ``(P, 3)`` [m].
        widths: ``(P,)`` [m].

    Returns:
        ``(NUM_POINTS, 4)`` float32: x, y, z and the distance from the line to the road's edge
        [m]. Where the road is not known that far, it goes straight on.
    """
    chain = _chain(starts, ends)
    points = np.empty((2 * len(chain) + 1, 3))
    points[:-1:2], points[1:-1:2] = starts[chain], ends[chain]
    points[-1:] = _tail(points[:-1])
    steps = points[1:] - points[:-1]
    marks = np.zeros(len(points))
    np.cumsum(np.sqrt((steps**2).sum(axis=1)), out=marks[1:])
    line = np.empty((NUM_POINTS, 4), np.float32)
    for column in range(3):
        line[:, column] = np.interp(_POINTS, marks, points[:, column])
    rooms = np.repeat(widths[chain] / 2, 2)
    rooms = np.concatenate([rooms, rooms[-1:]])
    line[:, 3] = np.interp(_POINTS, marks, rooms)
    return line


def _tail(points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """A point ``(1, 3)`` far beyond the end of a line."""
    last = points[-1] - points[-2]
    return np.asarray(points[-1:] + last * (_TAIL / max(float(np.linalg.norm(last)), 1e-3)))


def _chain(starts: FloatArray, ends: FloatArray) -> npt.NDArray[np.intp]:
    """Indices of the segments that follow one another, beginning with the first."""
    count = len(starts)
    jumps = np.abs(starts[1:] - ends[:-1]).max(axis=1) if count > 1 else np.zeros(0)
    if (jumps < _TOUCHING).all():
        return np.arange(count)
    squares = squared(starts[None, :, :] - ends[:, None, :])
    squares[np.tri(count, dtype=bool)] = np.inf  # what follows comes later in driving order
    followers = squares.argmin(axis=1).tolist()
    is_last = (squares.min(axis=1) > _LONGEST_JUMP**2).tolist()
    chain = [0]
    while not is_last[chain[-1]]:
        chain.append(followers[chain[-1]])
    return np.array(chain, np.intp)


class RoadTable:
    """The lines ahead of all segments of a track.

    Attributes:
        lines: ``(N, NUM_POINTS, 4)`` float32, world frame; see :func:`road_line`.
        starts: ``(N, 3)`` float32 [m]: where each segment starts.
        along: ``(N, 3)`` float32 [m]: from there to its end.
        length: of a lap [m].
    """

    def __init__(self, track: TrackMap) -> None:
        self.length = track.length
        self.starts = np.ascontiguousarray(track.path_nodes[:, 0])
        self.along = track.path_nodes[:, 1] - track.path_nodes[:, 0]
        ahead = track.nodes_ahead(np.arange(track.num_nodes), MAX_SEGMENTS)
        widths = track.path_width[:, 0]
        self.lines = np.stack(
            [
                road_line(self.starts[nodes], track.path_nodes[nodes, 1], widths[nodes])
                for nodes in ahead
            ]
        )


def line_places(
    starts: FloatArray, along: FloatArray, looks: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Which points of its line a kart looks at.

    Args:
        starts: ``(A, 3)``: where the karts' own segments start, in frames in which the kart
            is at the origin.
        along: ``(A, 3)``: from there to the segments' ends.
        looks: ``(L,)``: how far ahead of the kart [m].

    Returns:
        ``(A, L)`` each: number of the point before, and how far it is on the way to the
        next, from 0 to 1.
    """
    squares = squared(along)
    share = -(starts * along).sum(-1) / np.where(squares > 0, squares, 1)
    passed = np.clip(share, 0, 1) * np.sqrt(squares)
    places = (passed[:, None] + looks) / np.float32(STEP)
    before = np.minimum(places.astype(np.intp), NUM_POINTS - 2)
    return before, (places - before).astype(np.float32)


def points_ahead(
    lines: FloatArray,
    nodes: IntArray,
    starts: FloatArray,
    along: FloatArray,
    looks: FloatArray,
) -> FloatArray:
    """The points ``(A, L, 4)`` of the lines ``nodes`` at :func:`line_places`."""
    before, share = line_places(starts, along, looks)
    first, second = lines[nodes[:, None], before], lines[nodes[:, None], before + 1]
    points: FloatArray = first + (second - first) * share[..., None]
    return points
