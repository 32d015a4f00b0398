"""The racing view of all karts of many races at once, straight from their snapshots.

This is what a learner uses that drives dozens of karts a step: the same numbers as the
wrapper's, without an observation in between.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.kernel import RacingObserver
from stkzoo.wrappers.racing.features import KERNEL_TABLES
from stkzoo.wrappers.racing.layout import SIZE
from stkzoo.wrappers.racing.road import RoadTable
from stkzoo.wrappers.racing.surroundings import LOOKS, Known, RoadArrays, surroundings_in

if TYPE_CHECKING:
    from stkzoo.engine.track import TrackMap

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]


class BatchedRacingView:
    """Sees for all karts of races on some tracks.

    Args:
        roads: the tracks' tables.
    """

    def __init__(self, roads: Sequence[RoadTable]) -> None:
        self._roads = [(road.lines, road.starts, road.along) for road in roads]
        self._observers = [RacingObserver(road, *KERNEL_TABLES) for road in self._roads]

    def observe(
        self,
        snapshots: Sequence[Snapshot],
        roads: Sequence[int],
        karts: Sequence[IntArray],
    ) -> FloatArray:
        """The views of some karts of each race.

        Args:
            snapshots: each race's moment.
            roads: the number of each race's track, among those of the constructor.
            karts: whose views, in each race: indices in grid order.

        Returns:
            ``(A, SIZE)`` float32: the karts of the first race, then those of the second, ...
        """
        ends = np.cumsum([len(who) for who in karts])
        views = np.empty((ends[-1], SIZE), np.float32)
        parts = np.split(views, ends[:-1])
        for snapshot, road, who, part in zip(snapshots, roads, karts, parts, strict=True):
            self._observers[road].observe(snapshot.data, np.ascontiguousarray(who, np.intp), part)
        return views

    def surroundings(
        self,
        snapshots: Sequence[Snapshot],
        roads: Sequence[int],
        karts: Sequence[IntArray],
        looks: FloatArray = LOOKS,
    ) -> Known:
        """What some karts of each race know of themselves, and what is around them.

        Args:
            snapshots: as for :meth:`observe`, as ``roads`` and ``karts``.
            roads: likewise.
            karts: likewise.
            looks: where their road is looked at [m].
        """
        first = np.cumsum([0, *(len(lines) for lines, _, _ in self._roads)])
        return surroundings_in(self._joined, snapshots, first[np.asarray(roads)], karts, looks)

    @functools.cached_property
    def _joined(self) -> RoadArrays:
        """The tables of all tracks as one."""
        lines, starts, along = map(np.concatenate, zip(*self._roads, strict=True))
        return lines, starts, along


@functools.lru_cache(maxsize=64)
def racing_view_of(track: TrackMap) -> BatchedRacingView:
    """The racing view on a track; takes some milliseconds the first time in a program."""
    return BatchedRacingView([RoadTable(track)])
