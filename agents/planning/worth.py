"""Computes the worth of plans for the next two seconds, for any number of karts at once.

For each kart, a few dozen plans (:mod:`.plans`) are simulated on the road ahead. The results are
grouped by the maneuver with which a plan begins: go on, brake, drift left, drift right. A policy
sees the best plan of each and chooses among them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from stkzoo import ItemType, PowerupType
from stkzoo.errors import ConfigError
from stkzoo.wrappers.racing import Surroundings

from . import FloatArray
from ._planning import survey_road, weigh_plans
from .motion import BOOST_LASTS, RELEASE_STEPS, RELEASE_TURN, STEERING_LAG, STEP, learned_motion
from .parameters import DriverParameters
from .plans import LONGEST_DRIFT, MANEUVERS, plan_table
from .road import (
    FASTEST,
    MARK_COUNT,
    MARK_SPACING,
    MOST_TURNED,
    NOWHERE,
    REACH,
    RIVALS,
    RivalMoment,
    RivalTracker,
    headings_of,
    line_of,
)

DoubleArray = npt.NDArray[np.float64]

#: Number of items considered.
_ITEMS = 8
#: Items and karts farther above or below than this are on another level of the track [m].
_LEVEL = 4.0
#: Items nearer than the first distance are too close to steer for; farther than the second, they
#: are ignored [m].
_NEAREST, _FARTHEST = 1.0, 60.0
#: Items farther than this beyond the edge of the road are ignored [m].
_BEYOND = 1.0
#: A miss by this much more than the radius earns nothing [m].
_BLUR = 0.5

#: Distance between the centers of colliding karts [m].
_LENGTH = 1.8
#: A rival less far ahead is beside the kart [m]; a lower approach speed is harmless [m/s].
_BESIDE, _HARMLESS = 0.5, 1.0
#: Time for which rivals are assumed to keep their speed across the road [s].
_CROSSING = 0.5

#: Minimum assumed speed of karts [m/s].
_SLOWEST = 5.0
#: Minimum assumed angle of the wheels at full lock [rad].
_LEAST_LOCK = 0.02
#: Worth of a maneuver without plans.
NEVER = -1e4

#: Logit of the prior per meter of worth, and its smallest logit.
_METER, LEAST_LOGIT = 2.0, -30.0


class OwnState(NamedTuple):
    """Own state of A karts, for the extension.

    Attributes:
        velocity: ``(A, 3)`` float32 [m/s].
        energy: ``(A, 1)`` float32 [s].
        jumping: ``(A,)`` int64, 1 in the air.
        powerup_type: ``(A,)`` int64, number of :class:`~stkzoo.PowerupType`.
        powerup_count: ``(A,)`` int64, number of shots.
    """

    velocity: FloatArray
    energy: FloatArray
    jumping: npt.NDArray[np.int64]
    powerup_type: npt.NDArray[np.int64]
    powerup_count: npt.NDArray[np.int64]

    @classmethod
    def of(cls, kart: Mapping[str, Any]) -> OwnState:
        """Returns the state in entries of the ``full`` view in batch form."""
        return cls(
            np.ascontiguousarray(kart["velocity"], np.float32),
            np.ascontiguousarray(kart["energy"], np.float32),
            *(np.ascontiguousarray(kart[key], np.int64) for key in cls._fields[2:]),
        )


class PlanRules:
    """The parameters of plans, in the forms that the extension expects.

    Attributes:
        parameters: the parameters.
        table: the plans.
        view: the rules of ``survey_road``.
        worths: ``(2, types)`` worth of item types for karts without and with a powerup [m].
        costs: the rules of ``weigh_plans``.
        motion: the network of the karts' motion, or an empty tuple.
    """

    __slots__ = ("costs", "motion", "parameters", "table", "view", "worths")

    def __init__(self, parameters: DriverParameters) -> None:
        self.parameters = parameters
        self.table = plan_table(parameters.lane_changes)
        self.view = _view_rules(parameters)
        self.worths = _worths(parameters)
        self.costs = _costs(parameters)
        self.motion = learned_motion() if parameters.learned_motion else ()

    def __reduce__(self) -> tuple[Any, ...]:
        return plan_rules, (self.parameters,)


@lru_cache(maxsize=64)
def plan_rules(parameters: DriverParameters) -> PlanRules:
    """Returns the rules for parameters."""
    return PlanRules(parameters)


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """The best plan of each maneuver, and the karts' positions on the road.

    Attributes:
        best: ``(3, A, 4)``: :attr:`worth`, :attr:`turn` and danger, the cost beyond the edge of the
            road [m].
        scene: ``(A, 5)``: :attr:`angle`, :attr:`offset`, :attr:`beyond`, the largest turn of the
            road in the near future [rad], and whether firing is useful.
        rivals: ``(A, R, 5)`` the nearest karts, nearest first: whether there is one, distance ahead
            along the road, offset from its middle [m], speed along the road relative to the
            observing kart, and across it [m/s].
    """

    best: FloatArray
    scene: FloatArray
    rivals: DoubleArray

    @property
    def worth(self) -> FloatArray:
        """``(A, 4)`` worth of the plans [m]; :data:`NEVER` if there is none."""
        return np.asarray(self.best[0])

    @property
    def turn(self) -> FloatArray:
        """``(A, 4)`` current turn, positive to the right [fraction of full lock]."""
        return np.asarray(self.best[1])

    @property
    def angle(self) -> FloatArray:
        """``(A,)`` direction of the kart relative to the road's [rad]."""
        return self.scene[:, 0]

    @property
    def offset(self) -> FloatArray:
        """``(A,)`` offset from the middle of the road, positive to the right [m]."""
        return self.scene[:, 1]

    @property
    def beyond(self) -> FloatArray:
        """``(A,)`` distance beyond the edge of the road, negative on the road [m]."""
        return self.scene[:, 2]


def weigh(
    rules: PlanRules,
    memory: FloatArray,
    kart: OwnState,
    max_steer_angle: FloatArray,
    around: Surroundings,
    tracker: RivalTracker | None,
) -> PlanOptions:
    """Returns the best plan of each maneuver.

    Args:
        rules: parameters of the plans.
        memory: ``(22, A)``, see :class:`.memory.PlanMemory`.
        kart: own state of the karts.
        max_steer_angle: ``(A, 1)`` [rad].
        around: their surroundings; the road at :data:`.road.LINE_MARKS` comes last. Plans on the
            racing line need ``line``.
        tracker: observations of nearby karts, which are updated; ``None`` to ignore them.

    Raises:
        ConfigError: the plans follow the racing line, and it is not observed.
    """
    count = len(kart.velocity)
    tangents = tangents_of(np.maximum(max_steer_angle, np.float32(_LEAST_LOCK)))
    line = _line_of(rules.parameters, around)
    headings = headings_of(line)
    before, now = _NOTHING, _NOTHING
    rivals = np.empty((count, 0 if tracker is None else RIVALS, 5))
    if tracker is not None:
        spots = np.empty((count, RIVALS, 2), np.float32)
        before, now = tracker.before, RivalMoment(spots, np.empty((count, 2), np.float32), headings)
        tracker.now = now
    rows, karts = np.empty(count, np.intp), np.empty((count, 16), np.float32)
    road, items = np.empty((count, 4, MARK_COUNT), np.float32), np.empty((count, _ITEMS, 4))
    scene, best = np.empty((count, 5), np.float32), np.empty((3, count, MANEUVERS), np.float32)
    seen = (line, headings, tangents, around.karts, around.items, around.item_types)
    out = (rows, karts, road, items, rivals, scene)
    survey_road(rules.view, rules.worths, memory, kart, seen, before, now[:2], out)
    weigh_plans(rules.table, rules.costs, rules.motion, rows, karts, road, items, rivals, best)
    return PlanOptions(best, scene, rivals)


def _line_of(rules: DriverParameters, around: Surroundings) -> FloatArray:
    """Returns the line that plans follow, ``(A, M + 1, 5)``."""
    if not rules.racing_line:
        return line_of(around.road)
    if around.line is None:
        raise ConfigError(
            "these plans follow the racing line, and the observations have no ground_line; give "
            "the agent the view 'ground'"
        )
    return around.line


_NOTHING = RivalMoment.unknown(0)


def _view_rules(rules: DriverParameters) -> DoubleArray:
    return np.array(
        [
            MARK_SPACING,
            _SLOWEST,
            rules.aim_distance,
            rules.aim_time,
            rules.wheel_base,
            rules.drift_speed,
            rules.brake_speed,
            rules.margin,
            rules.caution_room,
            rules.greatest_room,
            rules.straight_time,
            rules.item_radius,
            rules.bad_item_radius,
            _NEAREST,
            _FARTHEST,
            _LEVEL,
            _BEYOND,
            REACH,
            FASTEST,
            NOWHERE,
            STEP,
            MOST_TURNED,
            RELEASE_STEPS,
            LONGEST_DRIFT,
            PowerupType.SWITCH,
            rules.switch_reach,
            rules.danger,
            rules.nitro_speed,
            rules.nitro_turn,
            rules.straight_aim,
            rules.straight_angle,
            rules.fire_every,
            _METER,
            LEAST_LOGIT,
        ]
    )


def _costs(rules: DriverParameters) -> DoubleArray:
    return np.array(
        [
            RELEASE_TURN,
            STEERING_LAG,
            MARK_SPACING,
            rules.over_cost,
            rules.late_time,
            rules.late_cost,
            rules.angle_cost,
            *BOOST_LASTS,
            rules.boost_worth,
            rules.big_boost_worth,
            rules.boost_wait_cost * STEP,
            _BLUR,
            rules.bump_cost,
            rules.bump_width,
            _LENGTH,
            _BESIDE,
            _HARMLESS,
            _CROSSING,
        ]
    )


def _worths(rules: DriverParameters) -> FloatArray:
    worths = np.zeros((2, max(ItemType) + 1), np.float32)
    worths[:, ItemType.BONUS_BOX] = rules.box_worth, rules.second_box_worth
    worths[:, ItemType.NITRO_BIG] = rules.big_nitro_worth
    worths[:, ItemType.NITRO_SMALL] = rules.small_nitro_worth
    worths[:, ItemType.BANANA] = -rules.banana_cost
    worths[:, ItemType.BUBBLEGUM] = -rules.gum_cost
    return worths


def tangents_of(angles: FloatArray) -> FloatArray:
    """Returns the tangents of angles from -1 to 1 rad, with the same bits on every processor.

    The bits of ``numpy.tan`` depend on the processor. This is Lambert's continued fraction, which
    has an error below 1e-13 with eight terms.
    """
    x = angles.astype(np.float64)
    fraction = np.full_like(x, 15.0)
    for odd in range(13, 0, -2):
        fraction = odd - x * x / fraction
    return np.asarray(x / fraction, np.float32)
