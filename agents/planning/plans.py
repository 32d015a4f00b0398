"""Tables of the plans for the next two seconds, by the kart's ongoing maneuver.

A plan consists of stages. For each, it gives the range of turns, whether the kart drifts, and the
lane that it steers for. All tables have the same number of plans, so that one array holds those of
many karts; plans that a kart does not have are masked.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import BoolArray, FloatArray, IntArray
from .motion import BOOST_STEPS, BRAKE_TIME, BRAKING, DRIFT_TURN, RELEASE_STEPS, STEP

#: Durations of a plan's stages [s].
SPANS = np.array([0.1] * 4 + [0.2] * 8, np.float32)
#: Ends of the stages [s].
ENDS = np.cumsum(SPANS)
_BEGINS, _MIDDLES = ENDS - SPANS, ENDS - SPANS / 2

#: Maneuvers with which a plan begins.
FREE, BRAKE, DRIFT_LEFT, DRIFT_RIGHT = range(4)
MANEUVERS = 4

#: Number of items at which plans aim, one per plan.
ITEM_LANES = 2

#: Target lanes before and after a change; -1 is the left edge of the road, 1 the right edge.
Lanes = Sequence[tuple[float, float]]
SOME_LANES: Lanes = [(lane, lane) for lane in np.linspace(-0.9, 0.9, 5).tolist()]
FEW_LANES: Lanes = [(lane, lane) for lane in np.linspace(-0.8, 0.8, 4).tolist()]

#: Time of the lane change [s].
CHANGE_AT = 0.8

#: Possible numbers of steps for which the kart turns away before a drift.
SWINGS = (1, 2, 3)

#: Acceleration after braking [m/s²].
GAIN = 4.0

#: Plans that come this close to the big boost get credit for it [steps].
BIG_BOOST_IN_SIGHT = 20


def all_lanes(changes: int) -> Lanes:
    """Returns nine lanes, and all changes between ``changes`` lanes."""
    kept = [(lane, lane) for lane in np.linspace(-1.0, 1.0, 9).tolist()]
    return [*kept, *itertools.permutations(np.linspace(-0.9, 0.9, changes).tolist(), 2)]


class PlanTable(NamedTuple):
    """The plans of all states: ``S`` states, ``T`` stages, ``C`` plans.

    Attributes:
        spans: ``(T,)`` duration of each stage [s].
        least: ``(S, T, C)`` lower limit of the turn, positive to the right [fraction of full lock].
        most: ``(S, T, C)`` upper limit of the turn [fraction of full lock].
        drifts: ``(S, T, C)`` 1 while the kart drifts.
        releases: ``(S, T, C)`` 1 while it keeps turning after a drift.
        slower: ``(S, T, C)`` change of speed [m/s].
        lanes: ``(S, T, C)`` lateral target; -1 is the left edge of the road, 1 the right edge.
        items: ``(S, C)`` number of the item to drive over instead; -1 for none.
        maneuvers: ``(S, C)`` first maneuver of the plan; -1 if there is no plan.
        boosts: ``(S, C)`` boost that the plan earns: 0 for the small one, 1 for the big one, -1 for
            none.
        boost_steps: ``(S, C)`` time until it earns the boost [steps].
        needs_drift: ``(S, C)`` whether only karts that may begin a drift can follow the plan.
    """

    spans: FloatArray
    least: FloatArray
    most: FloatArray
    drifts: FloatArray
    releases: FloatArray
    slower: FloatArray
    lanes: FloatArray
    items: IntArray
    maneuvers: IntArray
    boosts: IntArray
    boost_steps: FloatArray
    needs_drift: BoolArray


#: Types of the columns that are not float32.
_TYPES = {"items": np.intp, "maneuvers": np.intp, "boosts": np.intp, "needs_drift": np.bool_}

_ZEROS, _ONES = np.zeros_like(SPANS), np.ones_like(SPANS)
#: A masked plan. A single plan is a table without the axes of states and plans.
_NO_PLAN = PlanTable(
    SPANS,
    *(_ZEROS, _ZEROS, _ZEROS, _ZEROS, _ZEROS, _ZEROS),
    *(np.array(-1), np.array(-1), np.array(-1)),
    boost_steps=np.zeros((), np.float32),
    needs_drift=np.array(False),
)


def _changed(plan: PlanTable, **columns: Any) -> PlanTable:
    return plan._replace(**{name: np.asarray(column) for name, column in columns.items()})


def _free(lanes: Lanes, release: int, *, boost: int = -1, brake: bool = False) -> list[PlanTable]:
    """Returns plans without a drift."""
    lost = -BRAKING * BRAKE_TIME
    regained = lost + GAIN * (ENDS[-1] - BRAKE_TIME)
    slower = np.interp(_BEGINS, [0.0, BRAKE_TIME, ENDS[-1]], [0.0, lost, regained])
    plan = _changed(
        _NO_PLAN,
        least=-_ONES,
        most=_ONES,
        releases=_between(0.0, release * STEP),
        slower=slower if brake else _ZEROS,
        maneuvers=BRAKE if brake else FREE,
        boosts=boost,
    )
    return _in_lanes(plan, lanes)


def _drift(
    lanes: Lanes,
    side: int,
    steps: int,
    *,
    boost: int,
    wait: int = 0,
    swing: int = 0,
    is_new: bool = False,
) -> list[PlanTable]:
    """Returns plans with one drift: wait out the last release, swing away, drift, release."""
    swings, begin = wait * STEP, (wait + swing) * STEP
    end = begin + steps * STEP
    is_swing, is_drift = _between(swings, begin), _between(begin, end)
    lower, upper = sorted(side * share for share in DRIFT_TURN)
    now = DRIFT_RIGHT if side > 0 else DRIFT_LEFT
    plan = _changed(
        _NO_PLAN,
        least=np.select([is_swing > 0, is_drift > 0], [-side, lower], -1.0),
        most=np.select([is_swing > 0, is_drift > 0], [-side, upper], 1.0),
        drifts=is_drift,
        releases=np.maximum(_between(0.0, swings), _between(end, end + RELEASE_STEPS * STEP)),
        maneuvers=FREE if wait or swing else now,
        boosts=boost,
        boost_steps=wait + swing + steps,
        needs_drift=is_new,
    )
    return _in_lanes(plan, lanes)


def _in_lanes(plan: PlanTable, lanes: Lanes) -> list[PlanTable]:
    """Returns the plan for each lane and for each item."""
    in_lanes = [
        _changed(plan, lanes=np.where(_MIDDLES < CHANGE_AT, before, after))
        for before, after in lanes
    ]
    return [*in_lanes, *(_changed(plan, items=item) for item in range(ITEM_LANES))]


def _between(begin: float, end: float) -> FloatArray:
    """Returns 1 for the stages between two times [s] and 0 for others, ``(T,)``."""
    return (np.greater_equal(_MIDDLES, begin) & np.less(_MIDDLES, end)).astype(np.float32)


def _without_drift(release: int, lanes: Lanes) -> list[PlanTable]:
    """Returns the plans of a kart that is not drifting but may still turn after a drift."""
    plans = _free(lanes, release) + _free(FEW_LANES, release, brake=True)
    for side in (-1, 1):
        drift = partial(_drift, side=side, steps=BOOST_STEPS[0], boost=0, wait=release, is_new=True)
        plans += drift(SOME_LANES)
        for swing in SWINGS:
            plans += drift(FEW_LANES, swing=swing)
    return plans


def _in_drift(side: int, steps: int, lanes: Lanes) -> list[PlanTable]:
    """Returns the plans of a kart in a drift."""
    small, big = (max(earned - steps, 0) for earned in BOOST_STEPS)
    earned = 1 if not big else 0 if not small else -1
    release = min(steps, RELEASE_STEPS)
    plans = _free(lanes, release, boost=earned) + _free(FEW_LANES, release, brake=True)
    if small:
        plans += _drift(lanes, side, small, boost=0)
    if big:
        plans += _drift(lanes, side, big, boost=1 if big <= BIG_BOOST_IN_SIGHT else -1)
    return plans


#: Drifts of more steps have the same plans.
LONGEST_DRIFT = BOOST_STEPS[1]


@lru_cache(maxsize=8)
def plan_table(changes: int) -> PlanTable:
    """Returns the plans of all states.

    Args:
        changes: number of lanes between which plans may change.
    """
    lanes = all_lanes(changes)
    states = [_without_drift(release, lanes) for release in range(RELEASE_STEPS + 1)]
    drifts = itertools.product((-1, 1), range(LONGEST_DRIFT + 1))
    states += [_in_drift(side, steps, lanes) for side, steps in drifts]
    most = max(map(len, states))
    rows = [[*plans, *[_NO_PLAN] * (most - len(plans))] for plans in states]
    columns: dict[str, npt.NDArray[Any]] = {}
    for name in PlanTable._fields[1:]:
        column = np.array([[getattr(plan, name) for plan in plans] for plans in rows])
        if column.ndim == 3:  # has an axis of stages
            column = np.ascontiguousarray(column.swapaxes(1, 2))
        columns[name] = column.astype(_TYPES.get(name, np.float32))
    return PlanTable(spans=SPANS, **columns)
