"""Where a race's numbers lie in the block of bytes that the engine writes of its world.

The engine can write its whole world as one block (what it pickles), which takes a few
microseconds where reading attribute by attribute takes ten times as long. The block's layout
is no promise of the engine's: :class:`~stkzoo.engine.race.GameRace` uses it only if, at the
race's start, everything in it is what the attributes say.

The block, all little-endian and unpadded: header; number of karts; karts; number of
items; items. A kart is a flag, two ids, its name and model with their lengths, and then
:data:`_STATE_KART`; an item is :data:`_STATE_ITEM`. Vectors come with their number of
dimensions and their length before them.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import ITEM_DTYPE, KART_DTYPE

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


def _copy_plan(source: Any, target: Any) -> npt.NDArray[np.int32]:
    """For each field, where it is, where it goes, and its 4-byte words; 0 for a single byte."""
    names = [name for name in source.names if not name.startswith("_")]
    plan = [
        (source.fields[name][1], target.fields[name][1], source[name].itemsize // 4)
        for name in names
    ]
    return np.array(plan, np.int32)


def _attribute_plan(target: Any) -> npt.NDArray[np.int32]:
    """For each attribute, its place and how many floats it has."""
    fields = [target.fields[name] for name in BY_ATTRIBUTE]
    return np.array([(offset, dtype.itemsize // 4) for dtype, offset, *_ in fields], np.int32)


_KART_PLAN, _ITEM_PLAN = _copy_plan(_STATE_KART, KART_DTYPE), _copy_plan(_STATE_ITEM, ITEM_DTYPE)
_ATTRIBUTE_PLAN = _attribute_plan(KART_DTYPE)


def block_plans(world: Any) -> tuple[Any, ...] | None:
    """What the kernel's :class:`~stkzoo.kernel.GameStepper` needs to read the block.

    The karts and items stay at their places all race long.

    Args:
        world: the race's ``pystk2.WorldState``, updated at least once.

    Returns:
        Places of the karts, what to copy of each; the place of the items, their size, what to
        copy of each; and which attributes of a kart go where. ``None`` if there is no block, or
        one of another layout.
    """
    try:
        places, items_at = _places(world.__getstate__()[0])
    except (AttributeError, IndexError, TypeError, ValueError, struct.error):
        return None
    return places, _KART_PLAN, items_at, _STATE_ITEM.itemsize, _ITEM_PLAN, _ATTRIBUTE_PLAN


def _places(block: bytes) -> tuple[npt.NDArray[np.intp], int]:
    """Where each kart's numbers begin, and where the items do."""
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
    return np.array(places, np.intp), offset
