"""The ground beside the road ahead, at marks along the line and in lanes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from stkzoo.engine.ground import Ground
from stkzoo.mdp.geometry import line_places
from stkzoo.mdp.spaces import GROUND_LANES, GROUND_MARKS
from stkzoo.names import GroundKind
from stkzoo.wrappers.racing.features import STEP
from stkzoo.wrappers.racing.surroundings import NUM_POINTS, RoadTable

if TYPE_CHECKING:
    from stkzoo.engine.track import TrackMap

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]
ByteArray = npt.NDArray[np.uint8]

#: Sample points of a cell: fraction of the way to the line's next point, and offset from the middle
#: of the lane [m]. They are dense enough to hit every column of the ground and thin walls.
_LOOKS = tuple(itertools.product((0.0, 0.25, 0.5, 0.75), (-0.1875, 0.1875)))
#: A cell with several kinds of ground takes the last kind in this order.
_ORDER = np.array([GroundKind[n] for n in ("GROUND", "SLOWED", "ZIPPER", "VOID", "WALL")], np.uint8)
_PLACE_IN_ORDER = np.argsort(_ORDER).astype(np.uint8)
#: Number of segments per lookup.
_CHUNK = 64


@dataclass(frozen=True, slots=True)
class GroundAhead:
    """The ground beside the road ahead of A karts, at ``GROUND_MARKS`` and ``GROUND_LANES``.

    Attributes:
        kind: ``(A, M, L)`` uint8, numbers of :class:`~stkzoo.names.GroundKind`.
        speed: ``(A, M, L)`` float32, the fraction of their top speed that karts keep there.
    """

    kind: ByteArray
    speed: FloatArray


class GroundTable:
    """The ground beside the lines ahead of all segments of a track.

    Args:
        road: the lines.
        ground: ground and walls of the track.
    """

    def __init__(self, road: RoadTable, ground: Ground) -> None:
        self._starts, self._along = road.starts, road.along
        shape = (len(road.lines), NUM_POINTS, len(GROUND_LANES))
        self._places = np.empty(shape, np.uint8)
        self._speeds = np.empty(shape, np.float32)
        for begin in range(0, len(road.lines), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            self._places[part], self._speeds[part] = _look(road.lines[part, :, :3], ground)

    def ahead(self, nodes: npt.NDArray[np.integer], locations: FloatArray) -> GroundAhead:
        """Returns the ground beside the road ahead of some karts.

        Args:
            nodes: ``(A,)`` segments of the karts.
            locations: ``(A, 3)`` locations of the karts, world frame [m].
        """
        starts, along = self._starts[nodes] - locations, self._along[nodes]
        before, _ = line_places(starts, along, GROUND_MARKS, STEP, NUM_POINTS)
        here, next_ = (nodes[:, None], before), (nodes[:, None], before + 1)
        return GroundAhead(
            kind=_ORDER[np.maximum(self._places[here], self._places[next_])],
            speed=0.5 * (self._speeds[here] + self._speeds[next_]),
        )


@lru_cache(maxsize=64)
def ground_table(track: TrackMap, ground: Ground) -> GroundTable:
    """Returns the table of a track; takes up to 0.4 s (black_forest: 1.2 s), once."""
    return GroundTable(RoadTable(track), ground)


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
