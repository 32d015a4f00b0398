"""What karts of many races know of themselves and what is around them, from snapshots."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import KART_DTYPE, Snapshot
from stkzoo.mdp.geometry import rotation_matrices, to_kart_frame
from stkzoo.mdp.spaces import POWERUP_COUNT_LIMIT
from stkzoo.wrappers.racing.features import ABSENT, LOOKS, Surroundings, line_places

__all__ = ["KartColumns", "RoadLines", "RoadSurroundings"]

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


class RoadLines(Protocol):
    """The lines ahead of a track's segments; a :class:`RoadTable` has them."""

    lines: FloatArray
    starts: FloatArray
    along: FloatArray


class RoadSurroundings:
    """Looks around for karts of races on some tracks.

    Args:
        roads: the tracks' tables.
    """

    def __init__(self, roads: Sequence[RoadLines]) -> None:
        if not roads:
            return
        self._lines = np.concatenate([road.lines for road in roads])
        self._starts = np.concatenate([road.starts for road in roads])
        self._along = np.concatenate([road.along for road in roads])
        sizes = [len(road.lines) for road in roads]
        self._offsets = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.intp)

    def look(
        self,
        snapshots: Sequence[Snapshot],
        roads: Sequence[int],
        karts: Sequence[IntArray],
        looks: FloatArray = LOOKS,
    ) -> tuple[dict[str, npt.NDArray[np.generic]], Surroundings]:
        """What some karts of each race know of themselves, and what is around them.

        Args:
            snapshots: each race's moment.
            roads: the number of each race's track, among those of the constructor.
            karts: which karts, in each race: indices in grid order.
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
