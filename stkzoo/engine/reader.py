"""From the engine's world to arrays, once a step.

The engine can write its whole world as one block of bytes (what it pickles), which takes
a few microseconds where reading attribute by attribute takes ten times as long. The
block's layout is no promise of the engine's, so it is used only if, at the race's start,
everything in it is what the attributes say; otherwise attributes are read.

The block, all little-endian and unpadded: header; number of karts; karts; number of
items; items. A kart is a flag, two ids, its name and model with their lengths, and then
:data:`_STATE_KART`; an item is :data:`_STATE_ITEM`. Vectors come with their number of
dimensions and their length before them.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import CONTROLS, ITEM_DTYPE, KART_DTYPE

__all__ = ["BY_ATTRIBUTE", "WorldReader"]

Records = npt.NDArray[np.void]

_INT = struct.Struct("<i")
#: World time, then the number of players, each a flag, a kart id and "has no camera".
_PLAYERS_AT, _PLAYER_SIZE = 4, 6


def _vector(name: str, size: int) -> list[tuple[Any, ...]]:
    return [(f"_{name}_shape", "<i4", 2), (name, "<f4", size)]


_STATE_KART = np.dtype(
    [
        *_vector("location", 3),
        *_vector("rotation", 4),
        *_vector("front", 3),
        *_vector("velocity", 3),
        *_vector("velocity_lc", 3),
        *_vector("size", 3),
        ("shield_time", "<f4"),
        ("race_result", "u1"),
        ("jumping", "u1"),
        ("position", "<i4"),
        ("energy", "<f4"),
        ("finished_laps", "<i4"),
        ("lap_time", "<f4"),
        ("finish_time", "<f4"),
        ("overall_distance", "<f4"),
        ("distance_down_track", "<f4"),
        ("max_steer_angle", "<f4"),
        ("wheel_base", "<f4"),
        ("attachment_type", "u1"),
        ("attachment_time_left", "<f4"),
        ("powerup_type", "u1"),
        ("powerup_num", "<i4"),
        ("_unknown", "<i4"),
        ("skeed_factor", "<f4"),
        ("has_finished_race", "u1"),
        ("node", "<i4"),
        ("is_on_road", "u1"),
    ]
)

_STATE_ITEM = np.dtype(
    [
        ("_flag", "u1"),
        ("id", "<i4"),
        *_vector("location", 3),
        ("size", "<f4"),
        ("type", "<i4"),
    ]
)

#: Fields of a kart that the block does not hold, or not at a place that is known.
BY_ATTRIBUTE = ("angular_velocity", "speed")

_COPIED_KART = [name for name in _STATE_KART.names or () if not name.startswith("_")]
_COPIED_ITEM = [name for name in _STATE_ITEM.names or () if not name.startswith("_")]


def _copy_plan(source: Any, target: Any, names: Iterable[str]) -> npt.NDArray[np.int32]:
    """For each field, where it is, where it goes, and its 4-byte words; 0 for a single byte."""
    plan = []
    for name in names:
        dtype, from_offset, *_ = source.fields[name]
        plan.append((from_offset, target.fields[name][1], dtype.itemsize // 4))
    return np.array(plan, np.int32)


_KART_PLAN = _copy_plan(_STATE_KART, KART_DTYPE, _COPIED_KART)
_ITEM_PLAN = _copy_plan(_STATE_ITEM, ITEM_DTYPE, _COPIED_ITEM)


def _attribute_plan(target: Any, names: Iterable[str]) -> npt.NDArray[np.int32]:
    """For each field, its place, how many numbers it has, and whether they are whole."""
    plan = []
    for name in names:
        dtype, offset, *_ = target.fields[name]
        plan.append((offset, dtype.itemsize // 4, dtype.base.kind == "i"))
    return np.array(plan, np.int32)


_ATTRIBUTE_PLAN = _attribute_plan(KART_DTYPE, BY_ATTRIBUTE)


class WorldReader:
    """Reads the karts and items of one race.

    Args:
        world: the race's ``pystk2.WorldState``, updated at least once.

    Attributes:
        is_fast: whether the block of bytes is used.
    """

    def __init__(self, world: Any) -> None:
        self._world = world
        self._kart_places = np.empty(0, np.intp)
        self._items_at = 0
        try:
            self._learn(world.__getstate__()[0])
            self.is_fast = self._agrees()
        except (AttributeError, IndexError, TypeError, ValueError, struct.error):
            self.is_fast = False

    def read(self) -> tuple[Records, Records]:
        """All karts and items now: records of ``KART_DTYPE`` and ``ITEM_DTYPE``."""
        return self._read_block() if self.is_fast else self._read_attributes()

    @property
    def plans(self) -> tuple[Any, ...]:
        """What the compiled kernel's engine needs to read the block by itself.

        Places of the karts, what to copy of each; the place of the items, their size, what
        to copy of each; and which attributes of a kart go where.
        """
        items = self._items_at, _STATE_ITEM.itemsize, _ITEM_PLAN
        return self._kart_places, _KART_PLAN, *items, _ATTRIBUTE_PLAN

    def _learn(self, block: bytes) -> None:
        """Finds the places of the karts, which stay where they are all race long."""
        offset = _PLAYERS_AT + _INT.size + _PLAYER_SIZE * _INT.unpack_from(block, _PLAYERS_AT)[0]
        (num_kart,) = _INT.unpack_from(block, offset)
        offset += _INT.size
        places = []
        for _ in range(num_kart):
            offset += 1 + 2 * _INT.size
            for _ in ("name", "model"):
                offset += _INT.size + _INT.unpack_from(block, offset)[0]
            places.append(offset)
            offset += _STATE_KART.itemsize
        self._kart_places = np.array(places, np.intp)
        self._items_at = offset

    def _agrees(self) -> bool:
        by_block, by_attribute = self._read_block(), self._read_attributes()
        return all(
            ours.tobytes() == theirs.tobytes()
            for ours, theirs in zip(by_block, by_attribute, strict=True)
        )

    def _read_block(self) -> tuple[Records, Records]:
        block = self._world.__getstate__()[0]
        karts = np.zeros(len(self._kart_places), KART_DTYPE)
        _copy(block, self._kart_places, _STATE_KART, karts)
        for name in BY_ATTRIBUTE:
            karts[name] = [getattr(kart, name) for kart in self._world.karts]
        (num_items,) = _INT.unpack_from(block, self._items_at)
        items = np.zeros(num_items, ITEM_DTYPE)
        begin = self._items_at + _INT.size
        _copy(block, begin + _STATE_ITEM.itemsize * np.arange(num_items), _STATE_ITEM, items)
        return karts, items

    def _read_attributes(self) -> tuple[Records, Records]:
        karts = _records(KART_DTYPE, self._world.karts, _kart_record)
        items = _records(ITEM_DTYPE, self._world.items, _item_record)
        return karts, items


def _copy(
    block: bytes, places: npt.NDArray[np.intp], source: np.dtype[np.void], records: Records
) -> None:
    """Fills the fields that records share with what begins at some places of the block."""
    rows = np.frombuffer(block, np.uint8)[np.add.outer(places, np.arange(source.itemsize))]
    state = rows.view(source)[:, 0]
    for name in state.dtype.names or ():
        if not name.startswith("_"):
            records[name] = state[name]


def _records(
    dtype: np.dtype[np.void], objects: Iterable[Any], record: Callable[[Any], tuple[Any, ...]]
) -> Records:
    return np.array([record(thing) for thing in objects], dtype)


def _item_record(item: Any) -> tuple[Any, ...]:
    """The fields of ``ITEM_DTYPE`` in its order."""
    return item.location, item.size, item.type.value, item.id


_ZERO_CONTROL = (0.0,) * len(CONTROLS)


def _kart_record(kart: Any) -> tuple[Any, ...]:
    """The fields of ``KART_DTYPE`` in its order."""
    powerup, attachment = kart.powerup, kart.attachment
    return (
        kart.location,
        kart.rotation,
        kart.front,
        kart.velocity,
        kart.velocity_lc,
        kart.angular_velocity,
        kart.size,
        kart.speed,
        kart.max_steer_angle,
        kart.wheel_base,
        kart.energy,
        kart.skeed_factor,
        kart.shield_time,
        attachment.time_left,
        kart.distance_down_track,
        kart.overall_distance,
        kart.finish_time,
        kart.lap_time,
        kart.node,
        kart.position,
        kart.finished_laps,
        powerup.type.value,
        powerup.num,
        attachment.type.value,
        kart.has_finished_race,
        kart.race_result,
        kart.jumping,
        kart.is_on_road,
        _ZERO_CONTROL,
    )
