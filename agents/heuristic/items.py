"""The items on the road, and what they are worth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo import ItemType, PowerupType
from stkzoo.agents.planning import DriverParameters

from .forecast import Forecast
from .plans import ITEM_LANES
from .road import SPACING, Road

__all__ = ["RoadItems"]

FloatArray = npt.NDArray[np.float64]

#: Items looked at; they come nearest first, those in front before those behind.
_MAX_ITEMS = 12

#: An item on another level of the track is farther above or below than this [m].
_LEVEL = 4.0

#: Items nearer than this cannot be steered for any more, farther ones are out of sight [m].
_NEAREST, _FARTHEST = 1.0, 60.0

#: Items this far beyond the edge of the road are not on it [m].
_BEYOND = 1.0

#: A miss by so much more than the radius earns nothing [m].
_BLUR = 0.5

_NUM_TYPES = max(ItemType) + 1


@dataclass(frozen=True, slots=True)
class RoadItems:
    """The items ahead that matter, nearest first.

    Attributes:
        along: ``(M,)`` where they are along the road [m].
        across: ``(M,)`` and across it, positive to the right [m].
        worth: ``(M,)`` metres of way that they are worth, negative for the bad ones.
        radius: ``(M,)`` the kart gets those that it passes as near as this [m].
    """

    along: FloatArray
    across: FloatArray
    worth: FloatArray
    radius: FloatArray

    @classmethod
    def of(
        cls, observation: Mapping[str, Any], road: Road, rules: DriverParameters
    ) -> RoadItems | None:
        """The items of an observation of the ``full`` view; ``None`` if none matter."""
        types = np.array(observation["items_type"][:_MAX_ITEMS], np.intp)
        if not len(types):
            return None
        worth = _worths(observation, rules)[types]
        spots = np.concatenate(observation["items_position"][:_MAX_ITEMS], dtype=np.float64)
        spots = spots.reshape(-1, 3)
        matters = (worth != 0.0) & (spots[:, 2] > 0.0)
        if not matters.any():
            return None
        worth = worth[matters]
        along, across, above = road.place(spots[matters])
        edge = road.half_widths.take((along / SPACING).astype(np.intp), mode="clip") + _BEYOND
        kept = (along > _NEAREST) & (along < _FARTHEST)
        kept &= (np.abs(above) < _LEVEL) & (np.abs(across) < edge)
        if not kept.any():
            return None
        worth = worth[kept]
        radius = np.where(worth > 0.0, rules.item_radius, rules.bad_item_radius)
        return cls(along[kept], across[kept], worth, radius)

    def lanes(self) -> FloatArray:
        """How far across the road the next good items are, ``(ITEM_LANES,)`` [m]."""
        lanes = np.zeros(ITEM_LANES)
        good = self.across[self.worth > 0.0][:ITEM_LANES]
        lanes[: len(good)] = good
        return lanes

    def gain(self, ways: Forecast) -> FloatArray:
        """What plans earn by the items on their way, ``(C,)`` [m]."""
        gain = np.zeros(ways.along.shape[1])
        columns = np.arange(len(gain))
        last = len(ways.along) - 1
        longest = float(ways.along[last].max())
        for along, across, worth, radius in zip(
            self.along.tolist(),
            self.across.tolist(),
            self.worth.tolist(),
            self.radius.tolist(),
            strict=True,
        ):
            if along > longest:
                continue
            passed = ways.along >= along
            moment = passed.argmax(axis=0)
            after = ways.across[moment, columns]
            # straight between two moments; the way before the first one is short
            before = ways.across[np.maximum(moment - 1, 0), columns]
            from_, to = ways.along[np.maximum(moment - 1, 0), columns], ways.along[moment, columns]
            share = np.minimum(np.maximum((along - from_) / np.maximum(to - from_, 1e-3), 0.0), 1.0)
            beside = np.abs(before + (after - before) * share - across)
            hit = np.minimum(np.maximum((radius - beside) / _BLUR + 1.0, 0.0), 1.0)
            gain += worth * hit * passed[last]
        return gain


def _worths(observation: Mapping[str, Any], rules: DriverParameters) -> FloatArray:
    """What items are worth by type [m]."""
    worths = np.zeros(_NUM_TYPES)
    has_powerup = observation["powerup_type"] != PowerupType.NOTHING
    worths[ItemType.BONUS_BOX] = rules.second_box_worth if has_powerup else rules.box_worth
    worths[ItemType.NITRO_BIG] = rules.big_nitro_worth
    worths[ItemType.NITRO_SMALL] = rules.small_nitro_worth
    worths[ItemType.BANANA] = -rules.banana_cost
    worths[ItemType.BUBBLEGUM] = -rules.gum_cost
    return worths
