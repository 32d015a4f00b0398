"""The racing line of a track: short and smooth, on the free ground beside the driving line.

The driving line is the middle of the road as the game's AI knows it. Karts that cut curves drive a
shorter way, and many tracks have ground beside the road that is as fast as the road. The racing
line moves each end of the driving line's segments sideways, so that the sum of squared curvatures
and of the squared length is least. It keeps :data:`_KEPT` to the edges of the free ground.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.ground import Ground
from stkzoo.engine.snapshot import Snapshot
from stkzoo.engine.track import TrackMap
from stkzoo.mdp.spaces import GROUND_LANES, GROUND_LINE_MARKS, GROUND_MARKS
from stkzoo.names import GroundKind
from stkzoo.wrappers.racing.features import STEP
from stkzoo.wrappers.racing.surroundings import NUM_POINTS, RoadObserver, road_observer

FloatArray = npt.NDArray[np.float32]
DoubleArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]

#: Free ground farther than this beyond the edge of the driving line does not count [m].
_BEYOND = 1.5
#: Distance that the line keeps from the edges of the free ground, where there is room for it [m].
_KEPT = 3.0
#: Weight of the length of the line [1/m²], relative to its squared curvature.
_LENGTH_WEIGHT = 0.05
#: Least distance from the line to an edge [m].
_LEAST_ROOM = 1.0

#: Distance between the places at which the ground is looked up, along and across the road [m].
_ALONG, _ACROSS = 1.0, 0.25
#: Largest difference in height between two of these places [m]; a larger one is a wall or a drop.
_STEP_HEIGHT = 0.6
#: Slow ground counts as free if karts keep this fraction of their top speed.
_FAST = 0.85

#: Places nearer than this to the end of a segment limit the offset there [fraction of a segment].
_NEAR = 0.6
#: Weight of the bounds in the solver; with it, :data:`_ROUNDS` rounds reach the solution to 1 mm.
_PENALTY, _ROUNDS = 0.01, 500
#: Segments shorter than this count as this long in the curvature [m].
_SHORTEST = 0.5


@dataclass(frozen=True, slots=True)
class RacingLine:
    """The racing line of a track.

    Attributes:
        nodes: ``(N, 2, 3)`` float32, start and end of each segment, world frame [m].
        rooms: ``(N, 2)`` float32, least distance from each segment to the left and to the right
            edge of the free ground [m].
    """

    nodes: FloatArray
    rooms: FloatArray


def racing_line(track: TrackMap, ground: Ground) -> RacingLine:
    """Returns the racing line of a track."""
    places = _Places.on(track)
    left, right = (places.free_width(ground, side) for side in (-1, 1))
    vertices, ids = _vertices(track.path_nodes)
    lateral = _lateral(track.path_nodes, ids, len(vertices))
    low, high = _bounds(places, ids, left, right, len(vertices))
    offsets = _offsets(vertices, _edges(track, ids), lateral, low, high)
    moved = vertices.copy()
    moved[:, [0, 2]] += offsets[:, None] * lateral
    shift = offsets[ids[places.node, 0]] * (1 - places.share)
    shift += offsets[ids[places.node, 1]] * places.share
    rooms = np.full((track.num_nodes, 2), np.inf)
    for side, room in enumerate((left + shift, right - shift)):
        np.minimum.at(rooms[:, side], places.node, room)
    return RacingLine(
        moved[ids].astype(np.float32), np.maximum(rooms, _LEAST_ROOM).astype(np.float32)
    )


@dataclass(frozen=True, slots=True)
class _Places:
    """Places on the driving line, ``(P,)`` each: segment, fraction of its length, half width [m].

    ``points`` and ``lateral`` ``(P, 3)`` are the places and the directions to the right.
    """

    node: IntArray
    share: DoubleArray
    half_width: DoubleArray
    points: DoubleArray
    lateral: DoubleArray

    @classmethod
    def on(cls, track: TrackMap) -> _Places:
        starts, ends = track.path_nodes.astype(np.float64).transpose(1, 0, 2)
        along = ends - starts
        counts = np.maximum((np.sqrt((along**2).sum(axis=1)) / _ALONG).astype(np.intp) + 1, 2)
        node = np.repeat(np.arange(len(counts)), counts)
        share = np.concatenate([np.linspace(0, 1, count) for count in counts.tolist()])
        right = _right_of(along[:, [0, 2]])
        lateral = np.stack([right[:, 0], np.zeros(len(right)), right[:, 1]], axis=1)
        points = starts[node] + share[:, None] * along[node]
        half_width = track.path_width[node, 0].astype(np.float64) / 2
        return cls(node, share, half_width, points, lateral[node])

    def free_width(self, ground: Ground, side: int) -> DoubleArray:
        """Returns the width of the free ground on a side, at least that of the road, ``(P,)``.

        Args:
            ground: ground and walls of the track.
            side: 1 for the right, -1 for the left.
        """
        height, reach = self.points[:, 1].copy(), np.zeros(len(self.points))
        is_free = np.ones(len(self.points), bool)
        most = float(self.half_width.max()) + _BEYOND
        for offset in np.arange(0, most + _ACROSS, _ACROSS).tolist():
            points = self.points + side * offset * self.lateral
            points[:, 1] = height
            spots = ground.at(points, reach=_STEP_HEIGHT if offset else 3.0)
            is_fast = (spots.kind == GroundKind.SLOWED) & (spots.speed >= _FAST)
            is_free &= np.isin(spots.kind, (GroundKind.GROUND, GroundKind.ZIPPER)) | is_fast
            height = np.where(is_free, spots.height, height)
            reach = np.where(is_free, offset, reach)
        return self.half_width + np.clip(reach - self.half_width, 0, _BEYOND)


def _right_of(along: DoubleArray) -> DoubleArray:
    """Returns the unit vectors to the right of directions ``(..., 2)`` in x and z."""
    x, z = along[..., 0], along[..., 1]
    return np.stack([z, -x], axis=-1) / np.maximum(np.sqrt(x * x + z * z), 1e-6)[..., None]


def _vertices(nodes: FloatArray) -> tuple[DoubleArray, IntArray]:
    """Returns the distinct ends of segments ``(V, 3)``, and those of each segment ``(N, 2)``."""
    ends = nodes.reshape(-1, 3)
    keys = np.round(ends.astype(np.float64), 1)
    _, first, ids = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return ends[first].astype(np.float64), ids.reshape(-1, 2)


def _lateral(nodes: FloatArray, ids: IntArray, count: int) -> DoubleArray:
    """Returns the direction to the right at each vertex, ``(V, 2)`` in x and z."""
    right = _right_of((nodes[:, 1] - nodes[:, 0])[:, [0, 2]].astype(np.float64))
    total = np.zeros((count, 2))
    for end in range(2):
        np.add.at(total, ids[:, end], right)
    lengths = np.sqrt((total**2).sum(axis=1, keepdims=True))
    lateral: DoubleArray = total / np.maximum(lengths, 1e-6)
    return lateral


def _bounds(
    places: _Places, ids: IntArray, left: DoubleArray, right: DoubleArray, count: int
) -> tuple[DoubleArray, DoubleArray]:
    """Returns the least and the largest offset of each vertex [m]."""
    rooms = np.full((2, count), np.inf)
    for end in range(2):
        near = np.abs(places.share - end) <= _NEAR
        vertices = ids[places.node[near], end]
        for room, width in zip(rooms, (left, right), strict=True):
            np.minimum.at(room, vertices, width[near])
    middle = (rooms[1] - rooms[0]) / 2
    spare = np.maximum((rooms[0] + rooms[1]) / 2 - _KEPT, 0)
    return middle - spare, middle + spare


def _edges(track: TrackMap, ids: IntArray) -> IntArray:
    """Returns the pairs of vertices that follow each other, ``(E, 2)``."""
    gaps = [(ids[n, 1], ids[m, 0]) for n in range(len(ids)) for m in track.successors[n]]
    edges = np.unique(np.concatenate([ids, np.array(gaps, np.intp).reshape(-1, 2)]), axis=0)
    distinct: IntArray = edges[edges[:, 0] != edges[:, 1]]
    return distinct


def _offsets(
    vertices: DoubleArray,
    edges: IntArray,
    lateral: DoubleArray,
    low: DoubleArray,
    high: DoubleArray,
) -> DoubleArray:
    """Returns the offset of each vertex to the right [m]: a least-squares problem with bounds."""
    points, count = vertices[:, [0, 2]], len(vertices)
    start, end = edges.T
    length = np.maximum(np.sqrt(((points[end] - points[start]) ** 2).sum(axis=1)), _SHORTEST)
    first, second = np.nonzero(end[:, None] == start)  # edges that follow each other
    blocks = []
    for axis in range(2):
        # One row per edge: its vector, as a function of the offsets and of the driving line.
        rows, ahead = np.zeros((len(edges), count + 1)), np.arange(len(edges))
        rows[ahead, start], rows[ahead, end] = -lateral[start, axis], lateral[end, axis]
        rows[:, count] = points[end, axis] - points[start, axis]
        blocks.append(rows * np.sqrt(_LENGTH_WEIGHT / length)[:, None])
        rows /= length[:, None]
        between = (length[first] + length[second]) / 2
        blocks.append((rows[second] - rows[first]) / np.sqrt(between)[:, None])
    system = np.concatenate(blocks)
    return _least_squares(system[:, :count], -system[:, count], low, high)


def _least_squares(
    matrix: DoubleArray, wanted: DoubleArray, low: DoubleArray, high: DoubleArray
) -> DoubleArray:
    """Returns the vector within bounds whose product with a matrix is nearest to ``wanted``.

    Alternates between the problem without bounds and the bounds (ADMM: Boyd et al., 2011). The
    result is rounded to centimeters, because the last bits depend on the processor.
    """
    normal = matrix.T @ matrix + _PENALTY * np.eye(len(low))
    inverse, aim = np.linalg.inv(normal), matrix.T @ wanted
    bounded = np.clip(np.zeros(len(low)), low, high)
    apart = np.zeros(len(low))
    for _ in range(_ROUNDS):
        free = inverse @ (_PENALTY * (bounded - apart) + aim)
        bounded = np.clip(free + apart, low, high)
        apart += free - bounded
    return np.round(bounded, 2)


# ---------------------------------------------------------------------- ground beside the road

ByteArray = npt.NDArray[np.uint8]

#: Sample points of a cell: fraction of the way to the line's next point, and offset from the middle
#: of the lane [m]. They are dense enough to hit every column of the ground and thin walls.
_LOOKS = tuple(itertools.product((0.0, 0.25, 0.5, 0.75), (-0.1875, 0.1875)))
#: A cell with several kinds of ground takes the last kind in this order.
_ORDER = np.array([GroundKind[n] for n in ("GROUND", "SLOWED", "ZIPPER", "VOID", "WALL")], np.uint8)
_PLACE_IN_ORDER = np.argsort(_ORDER).astype(np.uint8)
#: Number of segments per lookup.
_CHUNK = 64


class GroundTable:
    """The ground beside the lines ahead of all segments of a track.

    Args:
        track: map of the track.
        ground: ground and walls of the track.
    """

    def __init__(self, track: TrackMap, ground: Ground) -> None:
        lines, self._starts, self._along, _ = road_observer(track).road
        shape = (len(lines), NUM_POINTS, len(GROUND_LANES))
        self._places = np.empty(shape, np.uint8)
        self._speeds = np.empty(shape, np.float32)
        for begin in range(0, len(lines), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            self._places[part], self._speeds[part] = _look(lines[part, :, :3], ground)

    def ahead(
        self, nodes: npt.NDArray[np.integer], locations: FloatArray
    ) -> tuple[ByteArray, FloatArray]:
        """Returns the ground beside the road ahead of some karts.

        Args:
            nodes: ``(A,)`` segments of the karts.
            locations: ``(A, 3)`` locations of the karts, world frame [m].

        Returns:
            ``(A, M, L)`` each, at ``GROUND_MARKS`` and ``GROUND_LANES``: numbers of
                :class:`~stkzoo.names.GroundKind`, uint8; and the fraction of their top speed that
                karts keep there, float32.
        """
        starts, along = self._starts[nodes] - locations, self._along[nodes]
        x, y, z = along.T
        squares = x * x + y * y + z * z
        share = -(starts * along).sum(-1) / np.where(squares > 0, squares, 1)
        passed = np.clip(share, 0, 1) * np.sqrt(squares)
        places = (passed[:, None] + GROUND_MARKS) / np.float32(STEP)
        before = np.minimum(places.astype(np.intp), NUM_POINTS - 2)
        here, next_ = (nodes[:, None], before), (nodes[:, None], before + 1)
        ground = _ORDER[np.maximum(self._places[here], self._places[next_])]
        return ground, 0.5 * (self._speeds[here] + self._speeds[next_])


class GroundObserver:
    """Makes the observation entries of the ground ahead of karts, with the racing line.

    Args:
        track: map of the track.
        ground: ground and walls of the track.
    """

    def __init__(self, track: TrackMap, ground: Ground) -> None:
        self._table = GroundTable(track, ground)
        line = racing_line(track, ground)
        self._lines = [
            RoadObserver(
                replace(track, path_nodes=line.nodes, path_width=2 * line.rooms[:, [side]])
            )
            for side in range(2)
        ]

    def observe(self, snapshot: Snapshot, karts: IntArray) -> dict[str, npt.NDArray[Any]]:
        """Returns the entries ``ground_kind``, ``_speed``, ``_line`` and ``_room`` of some karts.

        Args:
            snapshot: current snapshot of the race.
            karts: ``(A,)`` indices of the karts.

        Returns:
            Arrays with a leading axis of A karts, see
                :func:`~stkzoo.mdp.spaces.kart_observation_space`.
        """
        records = snapshot.karts[karts]
        ground, speed = self._table.ahead(records["node"], records["location"])
        left, right = (
            line.surroundings(snapshot, karts, GROUND_LINE_MARKS).road for line in self._lines
        )
        return {
            "ground_kind": ground,
            "ground_speed": speed,
            "ground_line": left[..., :3],
            "ground_room": np.concatenate([left[..., 3:], right[..., 3:]], axis=-1),
        }


@lru_cache(maxsize=64)
def ground_observer(track: TrackMap, ground: Ground) -> GroundObserver:
    """Returns the observer of a track; takes up to 0.5 s (black_forest: 2.7 s), once."""
    return GroundObserver(track, ground)


def _look(points: FloatArray, ground: Ground) -> tuple[ByteArray, FloatArray]:
    """Samples the ground beside lines ``(N, P, 3)``; returns rank in ``_ORDER`` and speed."""
    steps = np.diff(points, axis=1)
    steps = np.concatenate([steps, steps[:, -1:]], axis=1)
    x, z = steps[..., 0], steps[..., 2]
    right = np.stack([z, np.zeros_like(x), -x], axis=-1)
    right /= np.maximum(np.linalg.norm(right, axis=-1, keepdims=True), 1e-6)
    seen = [
        ground.at(
            (points + steps * on)[:, :, None] + right[:, :, None] * (GROUND_LANES + to)[:, None]
        )
        for on, to in _LOOKS
    ]
    places = np.max([_PLACE_IN_ORDER[spots.kind] for spots in seen], axis=0)
    return places, np.mean([spots.speed for spots in seen], axis=0, dtype=np.float32)
