"""The road ahead as a line with evenly spaced points, built from track segments.

The line begins at the start of the kart's own segment and follows consecutive segments. At a fork
it follows the branch whose segments touch: the main road, or the side road that the kart is on. Its
points are :data:`STEP` metres apart, independent of the segments' lengths.
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

#: Number of segments used; 50 of the shortest segments on any track cover 100 m, forks need twice
#: as many.
MAX_SEGMENTS = 96

#: Distance between the line's points [m].
STEP = 2.0

#: Number of points of a line.
NUM_POINTS = 66

#: Segments closer than this [m] touch and belong to one branch; larger gaps are jumps between
#: branches.
_TOUCHING = 0.3

#: Longest jump [m]; the line ends at a longer one.
_LONGEST_JUMP = 25.0

#: Length of the straight extension beyond a line's last point [m].
_TAIL = 150.0

#: Distances along the line, from the kart, at which the road is observed [m].
MARKS = np.array([3, 6, 10, 14, 19, 25, 32, 40, 50, 62, 76, 92], np.float32)

#: Sampled distances: beside the kart, at the marks, and for headings :data:`BEYOND` farther [m].
BEYOND = 3.0
LOOKS = np.concatenate([[0.0], MARKS, MARKS + BEYOND]).astype(np.float32)

#: ``lines``, ``starts`` and ``along`` of a :class:`RoadTable`.
RoadArrays: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]

_POINTS = STEP * np.arange(NUM_POINTS)


def road_line(starts: FloatArray, ends: FloatArray, widths: FloatArray) -> FloatArray:
    """Returns the line ahead of the first of several segments.

    Args:
        starts: ``(P, 3)`` starts of the nearest :data:`MAX_SEGMENTS` segments [m], in any frame,
            ordered by driving distance; the kart's own segment comes first.
        ends: ``(P, 3)`` ends of the segments [m].
        widths: ``(P,)`` widths of the segments [m].

    Returns:
        ``(NUM_POINTS, 4)`` float32: x, y, z and the distance from the line to the road's edge [m].
            Beyond the known road the line continues straight.
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
    """Returns a point ``(1, 3)`` far beyond the end of a line."""
    last = points[-1] - points[-2]
    return np.asarray(points[-1:] + last * (_TAIL / max(float(np.linalg.norm(last)), 1e-3)))


def _chain(starts: FloatArray, ends: FloatArray) -> npt.NDArray[np.intp]:
    """Returns the indices of consecutive segments, beginning with the first."""
    count = len(starts)
    jumps = np.abs(starts[1:] - ends[:-1]).max(axis=1) if count > 1 else np.zeros(0)
    if (jumps < _TOUCHING).all():
        return np.arange(count)
    squares = squared(starts[None, :, :] - ends[:, None, :])
    squares[np.tri(count, dtype=bool)] = np.inf  # successors come later in driving order
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
        starts: ``(N, 3)`` float32, start of each segment [m].
        along: ``(N, 3)`` float32, vector from each segment's start to its end [m].
        length: length of a lap [m].
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
    """Returns the positions on a kart's line at given distances ahead.

    Args:
        starts: ``(A, 3)`` starts of the karts' own segments [m], in frames with the kart at the
            origin.
        along: ``(A, 3)`` vectors from there to the segments' ends [m].
        looks: ``(L,)`` distances ahead of the kart [m].

    Returns:
        ``(A, L)`` each: index of the preceding point, and fraction of the way to the next one.
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
    """Interpolates the lines ``nodes`` at :func:`line_places`; returns points ``(A, L, 4)``."""
    before, share = line_places(starts, along, looks)
    first, second = lines[nodes[:, None], before], lines[nodes[:, None], before + 1]
    points: FloatArray = first + (second - first) * share[..., None]
    return points
