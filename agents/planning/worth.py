"""Computes the worth of plans for the next two seconds, for any number of karts at once.

For each kart, a few dozen plans (:mod:`.plans`) are simulated on the road ahead. The results are
grouped by the maneuver with which a plan begins: go on, brake, drift left, drift right. A policy
sees the best plan of each and chooses among them.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from stkzoo import ItemType
from stkzoo.errors import ConfigError
from stkzoo.wrappers.racing import Surroundings

from . import FloatArray
from ._planning import plan_karts
from .memory import DriverMemory
from .motion import learned_motion
from .parameters import DriverParameters, rule_numbers
from .plans import MANEUVERS, plan_table

#: Logits of the offsets in the prior.
_LOGITS = np.array([-5.5, -4.5, -3.5, 0.0, -3.5, -4.5, -5.5], np.float32)
#: Logits of offsets that hold for several steps; smaller differences, so that training tries them.
_HELD_LOGITS = np.array([-4.5, -3.0, -2.0, 0.0, -2.0, -3.0, -4.5], np.float32)

#: Number of logits of the prior: maneuvers, offsets, and two buttons.
_NUM_LOGITS = MANEUVERS + len(_LOGITS) + 2 * 2

#: Worth of a maneuver without plans.
NEVER = -1e4
#: Smallest logit of a maneuver in the prior.
LEAST_LOGIT = -30.0


@lru_cache(maxsize=64)
def plan_parts(parameters: DriverParameters) -> tuple[Any, ...]:
    """Returns the argument ``plans`` of ``plan_karts`` for parameters."""
    return (
        rule_numbers(parameters),
        _worths(parameters),
        plan_table(parameters.lane_changes),
        learned_motion() if parameters.learned_motion else (),
        _LOGITS if parameters.turn_hold == 1 else _HELD_LOGITS,
    )


class PlanOptions(NamedTuple):
    """The best plan of each maneuver, and the karts' positions on the road.

    Attributes:
        worth: ``(A, 4)`` worth of the plans [m]; :data:`NEVER` if there is none.
        turn: ``(A, 4)`` current turn, positive to the right [fraction of full lock].
        danger: ``(A, 4)`` cost beyond the edge of the road [m].
        angle: ``(A,)`` direction of the kart relative to the road's [rad].
        offset: ``(A,)`` offset from the middle of the road, positive to the right [m].
        beyond: ``(A,)`` distance beyond the edge of the road, negative on the road [m].
        prior: ``(A, 15)`` logits of the choices in :data:`.driver.CHOICE_NAMES`.
    """

    worth: FloatArray
    turn: FloatArray
    danger: FloatArray
    angle: FloatArray
    offset: FloatArray
    beyond: FloatArray
    prior: FloatArray


def weigh(
    parameters: DriverParameters,
    memory: DriverMemory,
    around: Surroundings,
    inputs: FloatArray,
    first: int = 0,
) -> PlanOptions:
    """Returns the best plan of each maneuver, and writes a policy's inputs from them.

    Args:
        parameters: parameters of the plans.
        memory: the karts' memory; if other karts matter, its latest moment is updated.
        around: surroundings of the karts; the road at :data:`.memory.LINE_MARKS` comes last. Plans
            on the racing line need ``line``.
        inputs: ``(A, F)`` inputs of a policy. The function writes 39 columns; ``(0, 0)`` if there
            is no policy.
        first: index of the first of these columns.

    Raises:
        ConfigError: the plans follow the racing line, and it is not observed.
    """
    line = around.line if parameters.racing_line else None
    if parameters.racing_line and line is None:
        raise ConfigError(
            "these plans follow the racing line, and the observations have no ground_line; give "
            "the agent the view 'ground'"
        )
    count = len(around.road)
    best = np.empty((3, count, MANEUVERS), np.float32)
    scene, prior = np.empty((count, 3), np.float32), np.empty((count, _NUM_LOGITS), np.float32)
    is_watching = len(inputs) or parameters.bump_cost or parameters.learned_motion
    moments, out = memory.moments if is_watching else None, (best, scene, prior, inputs)
    plan_karts(plan_parts(parameters), memory.rows, around.arrays, line, moments, out, first)
    worth, turn, danger = best
    angle, offset, beyond = scene.T
    return PlanOptions(worth, turn, danger, angle, offset, beyond, prior)


def _worths(rules: DriverParameters) -> FloatArray:
    """Returns the worth of item types for karts without and with a powerup, ``(2, types)`` [m]."""
    worths = np.zeros((2, max(ItemType) + 1), np.float32)
    worths[:, ItemType.BONUS_BOX] = rules.box_worth, rules.second_box_worth
    worths[:, ItemType.NITRO_BIG] = rules.big_nitro_worth
    worths[:, ItemType.NITRO_SMALL] = rules.small_nitro_worth
    worths[:, ItemType.BANANA] = -rules.banana_cost
    worths[:, ItemType.BUBBLEGUM] = -rules.gum_cost
    return worths
