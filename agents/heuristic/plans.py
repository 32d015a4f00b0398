"""What the driver can do next: lists of plans to choose from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning.kart import BOOST_STEPS, BRAKING, DRIFT_TURN, RELEASE_STEPS, STEP
from stkzoo.agents.planning.plans import (
    BIG_BOOST_IN_SIGHT,
    BRAKE_TIME,
    CHANGE_AT,
    FEW_LANES,
    GAIN,
    ITEM_LANES,
    SOME_LANES,
    SWINGS,
    Lanes,
    all_lanes,
)

__all__ = [
    "BIG_BOOST_IN_SIGHT",
    "BRAKE_TIME",
    "CHANGE_AT",
    "FEW_LANES",
    "GAIN",
    "ITEM_LANES",
    "SOME_LANES",
    "SPANS",
    "SWINGS",
    "Lanes",
    "Plans",
    "all_lanes",
    "plans_in_drift",
    "plans_without_drift",
]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

#: A plan goes through so many moments, the near ones closer together: how long they last [s].
SPANS = np.array([0.1] * 4 + [0.2] * 8)
_ENDS = np.cumsum(SPANS)
_BEGINS, _MIDDLES = _ENDS - SPANS, _ENDS - SPANS / 2


@dataclass(frozen=True, slots=True)
class Plans:
    """``C`` plans of ``T`` moments each.

    Attributes:
        least: ``(T, C)`` share of full lock that can be turned, positive to the right, from
        most: ``(T, C)`` to this.
        drifts: ``(T, C)`` whether the kart drifts.
        releases: ``(T, C)`` whether it goes on turning after a drift.
        slower: ``(T, C)`` change of speed [m/s].
        lanes: ``(T, C)`` where to drive, -1 is the left edge of the road, 1 the right one.
        items: ``(C,)`` number of the item to drive over instead, -1 for none.
        sides: ``(C,)`` 1 if it drifts to the right now, -1 to the left, 0 not at all.
        brakes: ``(C,)`` whether it brakes now.
        boosts: ``(C,)`` 0 if it earns the small boost, 1 if the big one, -1 if none.
        boost_steps: ``(C,)`` in how many steps.
    """

    least: FloatArray
    most: FloatArray
    drifts: BoolArray
    releases: BoolArray
    slower: FloatArray
    lanes: FloatArray
    items: npt.NDArray[np.intp]
    sides: npt.NDArray[np.intp]
    brakes: BoolArray
    boosts: npt.NDArray[np.intp]
    boost_steps: FloatArray


@lru_cache(maxsize=64)
def plans_without_drift(release: int, may_drift: bool, changes: int) -> Plans:
    """The plans of a kart that does not drift.

    Args:
        release: for how many steps it still turns after a drift.
        may_drift: whether drifts may begin.
        changes: between so many lanes plans may change.
    """
    groups = [_free(all_lanes(changes), release), _free(FEW_LANES, release, brake=True)]
    for side in (-1, 1) if may_drift else ():
        length = BOOST_STEPS[0]
        groups.append(_drift(SOME_LANES, side, length, boost=0, wait=release))
        groups.extend(
            _drift(FEW_LANES, side, length, boost=0, wait=release, swing=swing) for swing in SWINGS
        )
    return _join(groups)


@lru_cache(maxsize=128)
def plans_in_drift(side: int, steps: int, changes: int) -> Plans:
    """The plans of a kart in a drift.

    Args:
        side: 1 to the right, -1 to the left.
        steps: how long it has drifted.
        changes: between so many lanes plans may change.
    """
    lanes = all_lanes(changes)
    small, big = (max(earned - steps, 0) for earned in BOOST_STEPS)
    earned = 1 if not big else 0 if not small else -1
    release = min(steps, RELEASE_STEPS)
    groups = [
        _free(lanes, release, boost=earned),
        _free(FEW_LANES, release, brake=True),
    ]
    if small:
        groups.append(_drift(lanes, side, small, boost=0))
    if big:
        in_sight = big <= BIG_BOOST_IN_SIGHT
        groups.append(_drift(lanes, side, big, boost=1 if in_sight else -1))
    return _join(groups)


def _free(lanes: Lanes, release: int, *, boost: int = -1, brake: bool = False) -> Plans:
    """Plans without any drift."""
    lost = -BRAKING * BRAKE_TIME
    regained = lost + GAIN * (_ENDS[-1] - BRAKE_TIME)
    slower = np.interp(_BEGINS, [0.0, BRAKE_TIME, _ENDS[-1]], [0.0, lost, regained])
    return _group(
        lanes,
        releases=_between(0.0, release * STEP),
        slower=slower if brake else np.zeros(len(SPANS)),
        brake=brake,
        boost=boost,
    )


def _drift(
    lanes: Lanes, side: int, steps: int, *, boost: int, wait: int = 0, swing: int = 0
) -> Plans:
    """Plans with one drift: wait for the end of the last, swing away, drift, release."""
    swings, begin = wait * STEP, (wait + swing) * STEP
    end = begin + steps * STEP
    is_swing, is_drift = _between(swings, begin), _between(begin, end)
    lower, upper = sorted(side * share for share in DRIFT_TURN)
    return _group(
        lanes,
        least=np.select([is_swing, is_drift], [-side, lower], -1.0),
        most=np.select([is_swing, is_drift], [-side, upper], 1.0),
        drifts=is_drift,
        releases=_between(0.0, swings) | _between(end, end + RELEASE_STEPS * STEP),
        side=side,
        boost=boost,
        boost_steps=wait + swing + steps,
    )


def _between(begin: float, end: float) -> BoolArray:
    """Which moments lie between two times [s], ``(T,)``."""
    return np.greater_equal(_MIDDLES, begin) & np.less(_MIDDLES, end)


def _group(
    lanes: Lanes,
    *,
    least: FloatArray | None = None,
    most: FloatArray | None = None,
    drifts: BoolArray | None = None,
    releases: BoolArray,
    slower: FloatArray | None = None,
    side: int = 0,
    brake: bool = False,
    boost: int = -1,
    boost_steps: int = 0,
) -> Plans:
    """Plans that differ in their lanes only, and those for items."""
    zeros = np.zeros(len(SPANS))
    before, after = np.array([*lanes, *[(0.0, 0.0)] * ITEM_LANES]).T
    items = np.array([-1] * len(lanes) + list(range(ITEM_LANES)), np.intp)
    count = len(items)

    def spread(column: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.repeat(column[:, None], count, axis=1)

    return Plans(
        least=spread(zeros - 1 if least is None else least),
        most=spread(zeros + 1 if most is None else most),
        drifts=spread(zeros.astype(bool) if drifts is None else drifts),
        releases=spread(releases),
        slower=spread(zeros if slower is None else slower),
        lanes=np.where(_MIDDLES[:, None] < CHANGE_AT, before, after),
        items=items,
        sides=np.full(count, 0 if drifts is None else int(drifts[0]) * side, np.intp),
        brakes=np.full(count, brake),
        boosts=np.full(count, boost, np.intp),
        boost_steps=np.full(count, float(boost_steps)),
    )


def _join(groups: Sequence[Plans]) -> Plans:
    return Plans(
        *[
            np.ascontiguousarray(
                np.concatenate([getattr(group, name) for group in groups], axis=-1)
            )
            for name in Plans.__slots__
        ]
    )
