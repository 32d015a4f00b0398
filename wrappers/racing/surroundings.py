"""The road ahead as a line with evenly spaced points, and the surroundings of karts.

The line is built from track segments. It begins at the start of the kart's own segment and follows
consecutive segments. At a fork it follows the branch whose segments touch: the main road, or the
side road that the kart is on. Its points are ``STEP`` meters apart, independent of the lengths of
segments.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from stkzoo.kernel import join_rows, look_around, observe_racing, trace_roads, write_racing_view
from stkzoo.wrappers.racing.features import KERNEL_TABLES, LOOKS, OWN_PLACES, OWN_SIZE, SIZE, STEP

if TYPE_CHECKING:
    from stkzoo.engine.snapshot import Snapshot
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


def traced(
    starts: FloatArray,
    ends: FloatArray,
    widths: FloatArray,
    counts: IntArray,
    looks: FloatArray = _NO_LOOKS,
) -> tuple[FloatArray, FloatArray]:
    """Returns the lines of several roads, and their points at some distances.

    Args:
        starts: ``(A, P, 3)`` starts of the nearest :data:`MAX_SEGMENTS` segments of each road [m],
            in any frame, ordered by driving distance; the kart's own segment comes first.
        ends: ``(A, P, 3)`` ends of the segments [m].
        widths: ``(A, P)`` widths of the segments [m].
        counts: ``(A,)`` number of segments of each road; those after them are not used.
        looks: ``(L,)`` distances ahead of karts at the origin [m].

    Returns:
        ``(A, NUM_POINTS, 4)`` float32: x, y, z and the distance from the line to the road's edge
            [m]. Beyond the known road the line continues straight. ``(A, L, 4)`` float32: points of
            these lines.
    """
    lines = np.empty((len(counts), NUM_POINTS, 4), np.float32)
    points = np.empty((len(counts), len(looks), 4), np.float32)
    starts, ends, widths = map(np.ascontiguousarray, (starts, ends, widths))
    looks = np.ascontiguousarray(looks, np.float32)
    trace_roads(starts, ends, widths, counts, _RULES, lines, looks, points)
    return lines, points


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


class RoadObserver:
    """Makes the racing view and the surroundings of karts on one road directly from snapshots.

    It returns the same values as the wrapper but skips the ``full`` observation.

    Args:
        track: map of the track.

    Attributes:
        road: lines ahead of all segments, ``(N, NUM_POINTS, 4)`` float32, see :func:`traced`;
            start of each segment [m] and vector from there to its end [m], ``(N, 3)`` float32; all
            in the world frame; and the distance between two points of a line [m].
    """

    def __init__(self, track: TrackMap) -> None:
        starts, ends = np.ascontiguousarray(track.path_nodes[:, 0]), track.path_nodes[:, 1]
        ahead = track.nodes_ahead(np.arange(track.num_nodes), MAX_SEGMENTS)
        counts = np.full(len(ahead), ahead.shape[1])
        lines, _ = traced(starts[ahead], ends[ahead], track.path_width[ahead, 0], counts)
        self.road = lines, starts, ends - starts, STEP

    def observe_into(
        self, snapshot: Snapshot, karts: IntArray, rows: IntArray, views: FloatArray
    ) -> None:
        """Writes the views of some karts into rows of an array.

        Args:
            snapshot: current snapshot of the race.
            karts: ``(A,)`` indices of the karts.
            rows: ``(A,)`` row of each kart.
            views: ``(N, F)`` float32; the first ``SIZE`` columns are modified in place.
        """
        observe_racing(self.road, KERNEL_TABLES, snapshot.data, karts, rows, views)

    def surroundings(
        self,
        snapshot: Snapshot,
        karts: IntArray,
        looks: FloatArray = LOOKS,
        arrays: tuple[npt.NDArray[Any], ...] = (),
    ) -> Surroundings:
        """Returns the surroundings of some karts.

        Args:
            snapshot: current snapshot of the race.
            karts: ``(A,)`` indices of the karts.
            looks: ``(L,)`` float32, distances at which the road is observed [m].
            arrays: the first five arrays of :class:`Surroundings`, to be written; by default, new
                ones. Rows without a kart are infinite; items that are missing have the type
                :data:`ABSENT`.
        """
        count, num_items = len(karts), len(snapshot.items)
        arrays = arrays or (
            np.empty((count, OWN_SIZE), np.float32),
            np.empty((count, len(looks), 4), np.float32),
            np.empty((count, len(snapshot.karts), 3), np.float32),
            np.empty((count, num_items, 3), np.float32),
            np.empty((count, num_items), np.int64),
        )
        look_around(self.road, snapshot.data, karts, looks, arrays)
        return Surroundings(*arrays)


@functools.lru_cache(maxsize=64)
def road_observer(track: TrackMap) -> RoadObserver:
    """Returns the observer of a track; takes a few milliseconds the first time in a process."""
    return RoadObserver(track)


def racing_features(around: Surroundings, out: FloatArray | None = None) -> FloatArray:
    """Returns the view of A karts.

    Args:
        around: surroundings of the karts, with the road at :data:`LOOKS` first.
        out: array ``(A, F)`` whose first ``SIZE`` columns receive the view; ``None`` for a new one.

    Returns:
        ``(A, SIZE)`` float32, or ``out``.
    """
    view = np.empty((len(around.road), SIZE), np.float32) if out is None else out
    write_racing_view(KERNEL_TABLES, around.arrays, view)
    return view


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
    paths = [[rows[:MAX_SEGMENTS] for rows in batch[key]] for key in _PATHS]
    starts, ends, widths = map(_stacked, paths, (3, 3, 1))
    _, road = traced(starts, ends, widths, np.array([len(rows) for rows in paths[0]]), looks)
    ego = [np.reshape(batch[key], (len(road), -1)) for key in OWN_PLACES]
    line = [np.asarray(batch[key], np.float32) for key in _LINE if key in batch]
    return Surroundings(
        ego=np.concatenate(ego, axis=1, dtype=np.float32),
        road=road,
        karts=_stacked(batch["karts_position"], blank=np.inf),
        items=_stacked(batch["items_position"]),
        item_types=_stacked_types(batch["items_type"]),
        line=np.concatenate(line, axis=-1) if line else None,
    )


_PATHS = ("paths_start", "paths_end", "paths_width")
_LINE = ("ground_line", "ground_room")
_KEYS = (*OWN_PLACES, *_PATHS, "karts_position", "items_position", "items_type")


def _stacked(rows: Sequence[Any], size: int = 3, blank: float = 0.0) -> FloatArray:
    """Stacks the karts' vectors, padded to equal lengths."""
    counts = [*map(len, rows)]
    most = max(counts)
    vectors = tuple(itertools.chain.from_iterable(rows))
    joined = join_rows(vectors)
    block = np.array(vectors) if joined is None else np.frombuffer(joined, vectors[0].dtype)
    block = block.astype(np.float32, copy=False).reshape(-1, size)
    if min(counts) == most:
        return block.reshape(len(rows), most, size)
    stacked = np.full((len(rows), most, size), blank, np.float32)
    stacked[np.arange(most) < np.array(counts)[:, None]] = block
    return stacked


def _stacked_types(rows: Sequence[Any]) -> IntArray:
    stacked = np.full((len(rows), max(map(len, rows))), ABSENT, np.int64)
    for row, types in zip(stacked, rows, strict=True):
        row[: len(types)] = types
    return stacked
