"""The racing view of all karts of many races at once, straight from their snapshots.

This is what a learner uses that drives dozens of karts a step: the same numbers as the
wrapper's, without an observation in between.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import KART_DTYPE, Snapshot
from stkzoo.kernel import kernel
from stkzoo.mdp.geometry import rotation_matrices, to_kart_frame
from stkzoo.mdp.spaces import POWERUP_COUNT_LIMIT
from stkzoo.wrappers.racing.features import (
    ABSENT,
    KERNEL_TABLES,
    LOOKS,
    Surroundings,
    line_places,
    racing_features,
)
from stkzoo.wrappers.racing.layout import SIZE
from stkzoo.wrappers.racing.road import MAX_SEGMENTS, RoadTable

if TYPE_CHECKING:
    from stkzoo.engine.track import TrackMap

__all__ = ["BatchedRacingView", "KartColumns", "RacingSight"]

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]

_WORDS = KART_DTYPE.itemsize // 4


@dataclass(frozen=True, slots=True)
class KartColumns:
    """Records of karts, all their numbers as columns.

    Attributes:
        numbers: ``(A, W)`` float32: the records' words.
        choices: ``(A, W)`` int32: the same words.
    """

    numbers: FloatArray
    choices: npt.NDArray[np.int32]

    @classmethod
    def of(cls, karts: Sequence[npt.NDArray[np.void]]) -> KartColumns:
        """The records of several races, one after another."""
        words = np.concatenate([k.view(np.float32).reshape(-1, _WORDS) for k in karts])
        return cls(words, words.view(np.int32))

    def number(self, field: str) -> FloatArray:
        """A field of float32: ``(A,)``, or ``(A, n)`` for a vector."""
        return self.numbers[:, _place(field)]

    def choice(self, field: str) -> npt.NDArray[np.int32]:
        """A field of int32: ``(A,)``."""
        return self.choices[:, _place(field)]


@functools.cache
def _place(field: str) -> slice | int:
    """Where a field stands among a record's words."""
    layout = dict(KART_DTYPE.fields or {})
    part, offset, *_ = layout[field]
    begin, width = offset // 4, part.itemsize // 4
    return slice(begin, begin + width) if part.shape else begin


class BatchedRacingView:
    """Sees for all karts of races on some tracks.

    Args:
        roads: the tracks' tables.
    """

    def __init__(self, roads: Sequence[RoadTable]) -> None:
        if not roads:
            return
        self._lines = np.concatenate([road.lines for road in roads])
        self._starts = np.concatenate([road.starts for road in roads])
        self._along = np.concatenate([road.along for road in roads])
        sizes = [len(road.lines) for road in roads]
        self._offsets = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.intp)
        if kernel is not None:
            self._sights = [
                kernel.Racing((road.lines, road.starts, road.along), *KERNEL_TABLES)
                for road in roads
            ]

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
        if kernel is None:
            own, around = self.surroundings(snapshots, roads, karts)
            return racing_features(own, around)
        ends = np.cumsum([len(who) for who in karts])
        views = np.empty((ends[-1], SIZE), np.float32)
        parts = np.split(views, ends[:-1])
        for snapshot, road, who, part in zip(snapshots, roads, karts, parts, strict=True):
            self._sights[road].observe(snapshot.data, np.ascontiguousarray(who, np.intp), part)
        return views

    def surroundings(
        self,
        snapshots: Sequence[Snapshot],
        roads: Sequence[int],
        karts: Sequence[IntArray],
        looks: FloatArray = LOOKS,
    ) -> tuple[dict[str, npt.NDArray[np.generic]], Surroundings]:
        """What some karts of each race know of themselves, and what is around them.

        Args:
            snapshots: as for :meth:`observe`, as ``roads`` and ``karts``.
            roads: likewise.
            karts: likewise.
            looks: where their road is looked at [m].
        """
        counts = [len(who) for who in karts]
        race = np.repeat(np.arange(len(snapshots)), counts)
        columns = KartColumns.of([s.karts[who] for s, who in zip(snapshots, karts, strict=True)])
        locations = columns.number("location")
        matrices = rotation_matrices(np.ascontiguousarray(columns.number("rotation")))
        nodes = columns.choice("node") + self._offsets[np.asarray(roads)][race]
        items, types = self._items(snapshots, race, locations, matrices)
        around = Surroundings(
            road=self._road(nodes, locations, matrices, looks),
            karts=self._others(snapshots, karts, race, locations, matrices),
            items=items,
            item_types=types,
        )
        return _own(columns), around

    def _road(
        self, nodes: IntArray, locations: FloatArray, matrices: FloatArray, looks: FloatArray
    ) -> FloatArray:
        before, share = line_places(self._starts[nodes] - locations, self._along[nodes], looks)
        first = self._lines[nodes[:, None], before]
        second = self._lines[nodes[:, None], before + 1]
        points = first + (second - first) * share[..., None]
        seen = to_kart_frame(points[..., :3], locations, matrices)
        return np.concatenate([seen, points[..., 3:]], axis=-1)

    @staticmethod
    def _others(
        snapshots: Sequence[Snapshot],
        karts: Sequence[IntArray],
        race: IntArray,
        locations: FloatArray,
        matrices: FloatArray,
    ) -> FloatArray:
        most = max(len(s.karts) for s in snapshots)
        places = np.full((len(snapshots), most, 3), np.inf, np.float32)
        for row, snapshot in enumerate(snapshots):
            places[row, : len(snapshot.karts)] = snapshot.karts["location"]
        others = places[race]
        is_there = np.isfinite(others[..., 0])
        is_there[np.arange(len(race)), np.concatenate(karts)] = False
        seen = to_kart_frame(np.where(is_there[..., None], others, 0), locations, matrices)
        seen[~is_there] = np.inf
        return seen

    @staticmethod
    def _items(
        snapshots: Sequence[Snapshot], race: IntArray, locations: FloatArray, matrices: FloatArray
    ) -> tuple[FloatArray, npt.NDArray[np.int64]]:
        most = max(1, *(len(s.items) for s in snapshots))
        places = np.zeros((len(snapshots), most, 3), np.float32)
        types = np.full((len(snapshots), most), ABSENT, np.int64)
        for row, snapshot in enumerate(snapshots):
            count = len(snapshot.items)
            places[row, :count] = snapshot.items["location"]
            types[row, :count] = snapshot.items["type"]
        return to_kart_frame(places[race], locations, matrices), types[race]


def _own(columns: KartColumns) -> dict[str, npt.NDArray[np.generic]]:
    """The entries of the ``full`` view that a kart knows of itself, in batch form."""
    numbers = {
        key: columns.number(key)[:, None]
        for key in (
            "max_steer_angle",
            "skeed_factor",
            "energy",
            "attachment_time_left",
            "shield_time",
        )
    }
    return {
        **numbers,
        "velocity": columns.number("velocity_lc"),
        "jumping": columns.choice("jumping"),
        "powerup_type": columns.choice("powerup_type"),
        "powerup_count": np.minimum(columns.choice("powerup_num"), POWERUP_COUNT_LIMIT),
        "attachment": columns.choice("attachment_type"),
    }


class RacingSight:
    """The view ``racing`` of the agents of one race, without an observation in between."""

    def observe(
        self, track: TrackMap, snapshot: Snapshot, karts: IntArray, max_paths: int | None
    ) -> list[FloatArray] | None:
        """What some karts see.

        Args:
            track: the race's track.
            snapshot: the moment.
            karts: ``(A,)`` indices of the observing karts.
            max_paths: how many track segments ahead an observation has; ``None`` is all.

        Returns:
            ``(SIZE,)`` float32 for each; ``None`` if they see fewer segments than the view
            looks at.
        """
        if max_paths is not None and max_paths < MAX_SEGMENTS:
            return None
        return list(_view_of(track).observe([snapshot], [0], [karts]))


@functools.lru_cache(maxsize=64)
def _view_of(track: TrackMap) -> BatchedRacingView:
    return BatchedRacingView([RoadTable(track)])
