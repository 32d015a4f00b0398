"""What to do about the items on the road: drive over the good ones, around the bad ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.heuristic.line import CentreLine
from stkzoo.agents.heuristic.parameters import DriverParameters
from stkzoo.names import ItemType

__all__ = ["aim_for_items"]

FloatArray = npt.NDArray[np.float64]

_GOOD = [ItemType.BONUS_BOX, ItemType.NITRO_BIG, ItemType.NITRO_SMALL]
_BAD = [ItemType.BANANA, ItemType.BUBBLEGUM]

#: Items looked at; they come nearest first, those in front before those behind.
_MAX_ITEMS = 12

#: An item on another level of the track is farther above or below than this [m].
_LEVEL = 4.0

#: As :class:`~stkzoo.names.ItemType` number: 1 to collect, -1 to dodge, 0 to leave.
_WORTH = np.zeros(max(ItemType) + 1, int)
_WORTH[_GOOD] = 1
_WORTH[_BAD] = -1


def aim_for_items(
    aim: FloatArray, line: CentreLine, observation: Mapping[str, Any], rules: DriverParameters
) -> FloatArray:
    """Moves the aim ``(3,)`` [m] to a good item near the way, and off a bad one on it.

    Args:
        aim: where the road leads, kart frame.
        line: the road.
        observation: of the ``full`` view.
        rules: what counts as near.

    Returns:
        ``(3,)`` [m], kart frame.
    """
    if not observation["items_type"]:
        return aim
    types = np.array(observation["items_type"][:_MAX_ITEMS])
    spots = np.concatenate(observation["items_position"][:_MAX_ITEMS]).reshape(-1, 3)
    is_ahead = (spots[:, 2] > rules.item_min_ahead) & (np.abs(spots[:, 1]) < _LEVEL)
    worth = np.where(is_ahead, _WORTH[types], 0)
    if not worth.any():
        return aim
    slope = aim[0] / max(aim[2], 1.0)
    aside = spots[:, 0] - slope * spots[:, 2]
    target = _collect(aim, line, spots, aside, worth > 0, rules)
    return _dodge(target, line, spots, worth < 0, rules)


def _collect(
    aim: FloatArray,
    line: CentreLine,
    spots: FloatArray,
    aside: FloatArray,
    is_good: npt.NDArray[np.bool_],
    rules: DriverParameters,
) -> FloatArray:
    depths = spots[:, 2]
    is_near_way = is_good & (depths < rules.item_reach) & (
        np.abs(aside) < rules.item_swerve * depths
    )
    is_near_way &= depths < aim[2]
    for index in np.flatnonzero(is_near_way):
        if _is_on_road(spots[index], line, rules.item_edge):
            return spots[index]
    return aim


def _dodge(
    aim: FloatArray,
    line: CentreLine,
    spots: FloatArray,
    is_bad: npt.NDArray[np.bool_],
    rules: DriverParameters,
) -> FloatArray:
    slope = aim[0] / max(aim[2], 1.0)
    aside = spots[:, 0] - slope * spots[:, 2]
    is_in_way = is_bad & (spots[:, 2] < rules.dodge_reach) & (np.abs(aside) < rules.dodge_width)
    if not is_in_way.any():
        return aim
    index = int(np.flatnonzero(is_in_way)[0])
    side = -1.0 if aside[index] > 0 else 1.0
    passed = spots[index].astype(np.float64)
    passed[0] += side * rules.dodge_width
    if not _is_on_road(passed, line, 0.0):
        passed[0] -= 2 * side * rules.dodge_width
    return passed


def _is_on_road(spot: FloatArray, line: CentreLine, edge: float) -> bool:
    offsets = line.points - spot
    nearest = int((offsets * offsets).sum(axis=1).argmin())
    begin = max(nearest - 1, 0)
    along = line.points[begin + 1] - line.points[begin] if begin + 1 < len(line.points) else None
    if along is None:
        return False
    length = float(np.hypot(along[0], along[2]))
    if length < 1e-6:
        return False
    offset = spot - line.points[nearest]
    beside = abs(offset[0] * along[2] - offset[2] * along[0]) / length
    return bool(beside < line.half_widths[nearest] - edge)
