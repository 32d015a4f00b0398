"""What to do about the items on the road: drive over the good ones, around the bad ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo import ItemType

from .line import CentreLine
from .parameters import DriverParameters

__all__ = ["aim_for_items"]

FloatArray = npt.NDArray[np.float64]

_GOOD = [ItemType.BONUS_BOX, ItemType.NITRO_BIG, ItemType.NITRO_SMALL]
_BAD = [ItemType.BANANA, ItemType.BUBBLEGUM]

#: Items looked at; they come nearest first, those in front before those behind.
_MAX_ITEMS = 12

#: An item on another level of the track is farther above or below than this [m].
_LEVEL = 4.0

#: Ways past a bad item that are weighed: how far to the side of it [m].
_PASSES = np.linspace(-5.0, 5.0, 21)

#: As :class:`~stkzoo.names.ItemType` number: 1 to collect, -1 to dodge, 0 to leave.
_WORTH = np.zeros(max(ItemType) + 1, int)
_WORTH[_GOOD] = 1
_WORTH[_BAD] = -1


def aim_for_items(
    aim: FloatArray, line: CentreLine, observation: Mapping[str, Any], rules: DriverParameters
) -> FloatArray:
    """Moves the aim ``(3,)`` [m] to a good item near the way, and off the bad ones on it.

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
    spots = np.concatenate(observation["items_position"][:_MAX_ITEMS], dtype=np.float64)
    spots = spots.reshape(-1, 3)
    is_ahead = (spots[:, 2] > rules.item_min_ahead) & (np.abs(spots[:, 1]) < _LEVEL)
    worth = np.where(is_ahead, _WORTH[types], 0)
    if not worth.any():
        return aim
    target = _collect(aim, line, spots[worth > 0], rules)
    return _dodge(target, line, spots[worth < 0], rules)


def _collect(
    aim: FloatArray, line: CentreLine, goods: FloatArray, rules: DriverParameters
) -> FloatArray:
    """The nearest good item that is hardly a detour, or else the aim."""
    depths = goods[:, 2]
    is_near_way = (depths < min(rules.item_reach, aim[2])) & (
        _aside(goods, aim) < rules.item_swerve * depths
    )
    for spot in goods[is_near_way]:
        if _room(spot[None], line)[0] > rules.item_edge:
            return np.array(spot)
    return aim


def _dodge(
    aim: FloatArray, line: CentreLine, bads: FloatArray, rules: DriverParameters
) -> FloatArray:
    """The aim, or if bad items lie on the way there, the gentlest way past them."""
    bads = bads[bads[:, 2] < rules.dodge_reach]
    is_in_way = _aside(bads, aim) < rules.dodge_width
    if not is_in_way.any():
        return aim
    passes = np.repeat(bads[is_in_way][:1], len(_PASSES), axis=0)
    passes[:, 0] += _PASSES
    slopes = passes[:, 0] / passes[:, 2]
    beside = np.abs(bads[:, 0] - slopes[:, None] * bads[:, 2]).min(axis=1)
    danger = np.maximum(rules.dodge_width - beside, 0.0)
    danger += np.maximum(-_room(passes, line), 0.0)
    detour = np.abs(passes[:, 0]) + _aside(passes, aim)
    best = int((detour + rules.dodge_weight * danger).argmin())
    return np.array(passes[best])


def _aside(spots: FloatArray, aim: FloatArray) -> FloatArray:
    """How far the spots ``(M, 3)`` lie beside the straight way to the aim, ``(M,)`` [m]."""
    slope = aim[0] / max(aim[2], 1.0)
    return np.asarray(np.abs(spots[:, 0] - slope * spots[:, 2]))


def _room(spots: FloatArray, line: CentreLine) -> FloatArray:
    """Distance to the road's edge ``(M,)`` [m] of spots ``(M, 3)`` close to each other.

    Negative beyond the edge.
    """
    offsets = line.points - spots[len(spots) // 2]
    nearest = int((offsets * offsets).sum(axis=1).argmin())
    begin, end = line.points[max(nearest - 2, 0)], line.points[min(nearest + 2, len(offsets) - 1)]
    x, _, z = end - begin
    x0, _, z0 = line.points[nearest]
    beside = np.abs((spots[:, 0] - x0) * z - (spots[:, 2] - z0) * x) / max(np.hypot(x, z), 1e-6)
    return np.asarray(line.half_widths[nearest] - beside)
