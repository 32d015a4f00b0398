"""The road ahead as a line with evenly spaced points, built from track segments.

The line begins at the start of the kart's own segment and follows consecutive segments. At a fork
it follows the branch whose segments touch: the main road, or the side road that the kart is on. Its
points are :data:`STEP` meters apart, independent of the segments' lengths.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from stkzoo.kernel import trace_roads

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

_RULES = np.array([STEP, _TOUCHING, _LONGEST_JUMP, _TAIL])

#: For each road an array of vectors, or a sequence of vectors.
Vectors: TypeAlias = tuple[Any, ...]


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
    lines, _ = traced((starts,), (ends,), (widths,))
    line: FloatArray = lines[0]
    return line


def traced(starts: Vectors, ends: Vectors, widths: Vectors) -> tuple[FloatArray, FloatArray]:
    """Returns the lines of several roads and their first segments.

    Args:
        starts: starts of the segments of each road, an array or a sequence of vectors.
        ends: their ends.
        widths: their widths.

    Returns:
        ``(A, NUM_POINTS, 4)`` see :func:`road_line`; ``(A, 2, 3)`` starts and ends.
    """
    lines = np.empty((len(starts), NUM_POINTS, 4), np.float32)
    first = np.empty((len(starts), 2, 3), np.float32)
    trace_roads(starts, ends, widths, MAX_SEGMENTS, _RULES, lines, first)
    return lines, first


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
        ends, widths = track.path_nodes[:, 1], track.path_width[:, 0]
        self.lines, _ = traced(*(tuple(column[ahead]) for column in (self.starts, ends, widths)))
