"""The road ahead as a line with evenly spaced points, and the surroundings of karts.

The line is built from track segments. It begins at the start of the kart's own segment and follows
consecutive segments. At a fork it follows the branch whose segments touch: the main road, or the
side road that the kart is on. Its points are ``STEP`` meters apart, independent of the lengths of
segments.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from stkzoo.kernel import stack_vectors, trace_roads
from stkzoo.wrappers.racing.features import LOOKS, OWN_PLACES, STEP

if TYPE_CHECKING:
    from stkzoo.engine.track import TrackMap

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[Any]

#: Number of segments used; 50 of the shortest segments on any track cover 100 m, forks need twice
#: as many.
MAX_SEGMENTS = 96

#: Number of points of a line.
NUM_POINTS = 66

#: Segments closer than this [m] touch and belong to one branch; larger gaps are jumps between
#: branches.
_TOUCHING = 0.3

#: Longest jump [m]; the line ends at a longer one.
_LONGEST_JUMP = 25.0

#: Length of the straight extension beyond a line's last point [m].
_TAIL = 150.0

_RULES = np.array([STEP, _TOUCHING, _LONGEST_JUMP, _TAIL])
_NO_LOOKS = np.zeros(0, np.float32)

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
    lines, _ = traced(((starts,), (ends,), (widths,)))
    line: FloatArray = lines[0]
    return line


def traced(
    segments: Iterable[Vectors], looks: FloatArray = _NO_LOOKS
) -> tuple[FloatArray, FloatArray]:
    """Returns the lines of several roads, and their points at some distances.

    Args:
        segments: starts, ends and widths of the segments of each road; for each road an array or a
            sequence of vectors.
        looks: ``(L,)`` distances ahead of karts at the origin [m].

    Returns:
        ``(A, NUM_POINTS, 4)`` see :func:`road_line`; ``(A, L, 4)`` points of these lines.
    """
    starts, ends, widths = segments
    lines = np.empty((len(starts), NUM_POINTS, 4), np.float32)
    points = np.empty((len(starts), len(looks), 4), np.float32)
    looks = np.ascontiguousarray(looks, np.float32)
    trace_roads(starts, ends, widths, MAX_SEGMENTS, _RULES, lines, looks, points)
    return lines, points


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
        self.lines, _ = traced(tuple(column[ahead]) for column in (self.starts, ends, widths))


#: Type number of a missing item.
ABSENT = -1


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Surroundings of A karts, each in its own frame: x right, y up, z forward [m].

    Attributes:
        ego: ``(A, 12)`` own state of the karts: entries of the ``full`` view at
            :data:`OWN_PLACES`.
        road: ``(A, L, 4)`` points of the line and distances to the edge; by default at
            :data:`LOOKS`.
        karts: ``(A, K, 3)`` positions of the other karts; not finite if missing.
        items: ``(A, M, 3)`` positions of the items.
        item_types: ``(A, M)`` numbers of :class:`~stkzoo.names.ItemType`, or :data:`ABSENT`.
        line: ``(A, L, 5)`` points of the racing line at ``GROUND_LINE_MARKS``, and the room to its
            left and right; ``None`` if it is not observed.
    """

    ego: FloatArray
    road: FloatArray
    karts: FloatArray
    items: FloatArray
    item_types: IntArray
    line: FloatArray | None = None

    @property
    def arrays(self) -> tuple[npt.NDArray[Any], ...]:
        """The arrays without the line, in order, C-contiguous."""
        arrays = self.ego, self.road, self.karts, self.items, self.item_types
        return tuple(map(np.ascontiguousarray, arrays))


def surroundings_of(
    observation: Mapping[str, Any] | Sequence[Mapping[str, Any]], looks: FloatArray = LOOKS
) -> Surroundings:
    """Returns the surroundings of karts from observations in the ``full`` view.

    Args:
        observation: an observation of one kart, or a list of them, also from different races.
        looks: ``(L,)`` distances at which the road is observed [m].
    """
    seen = [observation] if isinstance(observation, Mapping) else observation
    keys = (*_KEYS, *(key for key in _LINE if key in seen[0]))
    batch = {key: [one[key] for one in seen] for key in keys}
    _, road = traced((tuple(batch[key]) for key in _PATHS), looks)
    ego = [np.reshape(batch[key], (len(road), -1)) for key in OWN_PLACES]
    return Surroundings(
        ego=np.concatenate(ego, axis=1, dtype=np.float32),
        road=road,
        karts=_stacked(batch["karts_position"], np.inf),
        items=_stacked(batch["items_position"], 0.0),
        item_types=_stacked_types(batch["items_type"]),
        line=_line_of(batch),
    )


_PATHS = ("paths_start", "paths_end", "paths_width")
_LINE = ("ground_line", "ground_room")
_KEYS = (*OWN_PLACES, *_PATHS, "karts_position", "items_position", "items_type")


def _stacked(rows: Sequence[Any], blank: float) -> FloatArray:
    """Stacks the karts' vectors, padded to equal lengths."""
    stacked = np.empty((len(rows), max(map(len, rows)), 3), np.float32)
    stack_vectors(tuple(rows), blank, stacked)
    return stacked


def _line_of(batch: Mapping[str, Any]) -> FloatArray | None:
    """Returns the racing lines ahead of the karts, if they are observed."""
    if _LINE[0] not in batch:
        return None
    return np.concatenate([np.asarray(batch[key], np.float32) for key in _LINE], axis=-1)


def _stacked_types(rows: Sequence[Any]) -> IntArray:
    stacked = np.full((len(rows), max(map(len, rows))), ABSENT, np.int64)
    for row, types in zip(stacked, rows, strict=True):
        row[: len(types)] = types
    return stacked
