"""Computes the worth of plans for the next two seconds, for any number of karts at once.

For each kart, a few dozen plans (:mod:`.plans`) are simulated on the road ahead with a simple model
of a kart. The results are grouped by the manoeuvre with which a plan begins: go on, brake, drift
left, drift right. A policy sees the best plan of each and chooses among them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from stkzoo import ItemType
from stkzoo.kernel import weigh_plans
from stkzoo.mdp import squared

from .arrays import BoolArray, FloatArray
from .kart import BOOST_LASTS, RELEASE_TURN, STEERING_LAG, STEP
from .memory import KartSituation
from .parameters import DriverParameters
from .plans import MANOEUVRES, plan_table, table_rows
from .rivals import Rivals
from .road import MARK_COUNT, MARK_SPACING, RoadAhead

DoubleArray = npt.NDArray[np.float64]

#: Number of items considered.
_ITEMS = 8
#: Items farther above or below than this are on another level of the track [m].
_LEVEL = 4.0
#: Items nearer than the first distance are too close to steer for; farther than the second, they
#: are ignored [m].
_NEAREST, _FARTHEST = 1.0, 60.0
#: Items farther than this beyond the edge of the road are ignored [m].
_BEYOND = 1.0
#: A miss by this much more than the radius earns nothing [m].
_BLUR = 0.5

#: Distance between the centres of colliding karts [m].
_LENGTH = 1.8
#: A rival less far ahead is beside the kart [m]; a lower approach speed is harmless [m/s].
_BESIDE, _HARMLESS = 0.5, 1.0
#: Time for which rivals are assumed to keep their speed across the road [s].
_CROSSING = 0.5

#: Minimum assumed speed of karts [m/s].
_SLOWEST = 5.0
#: Worth of a manoeuvre without plans.
NEVER = -1e4


@dataclass(frozen=True, slots=True)
class PlanScene:
    """Observations of A karts that affect plans.

    Attributes:
        speed: ``(A,)`` forward speed [m/s].
        max_steer_angle: ``(A,)`` [rad].
        is_jumping: ``(A,)`` bool.
        has_powerup: ``(A,)`` bool.
        road: the road ahead.
        items: ``(A, M, 3)`` in the kart's frame [m].
        item_types: ``(A, M)`` numbers of :class:`~stkzoo.ItemType`; other numbers are ignored.
        rivals: the nearest karts; ``None`` to ignore them.
    """

    speed: FloatArray
    max_steer_angle: FloatArray
    is_jumping: BoolArray
    has_powerup: BoolArray
    road: RoadAhead
    items: FloatArray
    item_types: npt.NDArray[np.integer]
    rivals: Rivals | None


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """The best plan of each manoeuvre, ``(A, 4)`` each, and the road.

    Attributes:
        worth: worth of the plan [m]; :data:`NEVER` if there is none.
        turn: current turn, positive to the right [fraction of full lock].
        danger: cost beyond the edge of the road [m].
        angle: ``(A,)`` direction of the kart relative to the road's [rad].
        offset: ``(A,)`` offset from the middle, positive to the right [m].
        beyond: ``(A,)`` distance beyond the edge of the road, negative on the road [m].
        straightness: ``(A,)`` largest turn of the road in the near future [rad].
    """

    worth: FloatArray
    turn: FloatArray
    danger: FloatArray
    angle: FloatArray
    offset: FloatArray
    beyond: FloatArray
    straightness: FloatArray


def weigh(scene: PlanScene, now: KartSituation, rules: DriverParameters) -> PlanOptions:
    """Returns the best plan of each manoeuvre.

    Args:
        scene: observations of the karts.
        now: their ongoing manoeuvres.
        rules: parameters of the plans.
    """
    road, count = scene.road, len(scene.speed)
    speed = np.maximum(scene.speed, _SLOWEST)
    reach = (rules.aim_distance + rules.aim_time * speed).astype(np.float32)
    karts = np.empty((count, 11), np.float32)
    columns = (
        speed,
        speed * np.tan(np.maximum(scene.max_steer_angle, 0.02)) / np.float32(rules.wheel_base),
        reach,
        now.turn,
        now.drift_turn,
        road.offset,
        road.angle,
        now.boost_steps,
        now.big_boost_steps,
        (scene.speed > rules.drift_speed) & ~scene.is_jumping & now.may_hop,
        scene.speed > rules.brake_speed,
    )
    for column, values in enumerate(columns):
        karts[:, column] = values
    widest = np.where(now.is_cautious, rules.caution_room, rules.greatest_room)
    room = np.minimum(np.maximum(road.half_widths - rules.margin, 0.3), widest[:, None])
    best = np.empty((3, count, MANOEUVRES), np.float32)
    weigh_plans(
        plan_table(rules.lane_changes),
        rule_columns(rules),
        table_rows(now.drift_side, now.drift_steps, now.release_steps),
        karts,
        road_columns(road, reach, room),
        _items(scene, rules),
        np.zeros((count, 0, 5)) if scene.rivals is None else scene.rivals.columns(),
        best,
    )
    worth, turn, danger = best
    return PlanOptions(
        worth=worth,
        turn=turn,
        danger=danger,
        angle=road.angle,
        offset=road.offset,
        beyond=np.abs(road.offset) - road.half_widths[:, 0],
        straightness=road.straightness(rules.straight_time * scene.speed),
    )


def road_columns(road: RoadAhead, reach: FloatArray, room: npt.NDArray[np.floating]) -> FloatArray:
    """Returns the road at its marks, ``(A, 3, 36)``: sideways bend [m], room [m], curvature [1/m].

    Args:
        road: the road.
        reach: ``(A,)`` distance at which karts aim [m].
        room: ``(A, 36)`` largest offset from the middle [m].
    """
    columns = np.empty((len(reach), 3, MARK_COUNT), np.float32)
    columns[:, 0] = road.bends(reach) * (0.5 * reach * reach)[:, None]
    columns[:, 1], columns[:, 2] = room, road.curvature
    return columns


@lru_cache(maxsize=64)
def rule_columns(rules: DriverParameters) -> DoubleArray:
    """Returns the parameters for all karts, in the order of :func:`stkzoo.kernel.weigh_plans`."""
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


def _items(scene: PlanScene, rules: DriverParameters) -> DoubleArray:
    """Returns the relevant items ahead, nearest first, ``(A, I, 4)``; missing ones have worth 0.

    The columns are position along the road, position across it, worth, and hit radius [m].
    """
    types = np.minimum(np.maximum(scene.item_types, -1), max(ItemType) + 1)  # -1: last entry
    worth = _worths(rules)[scene.has_powerup.astype(np.intp)[:, None], types]
    rows = np.arange(len(types))[:, None]
    squares = squared(scene.items)
    matters = (worth != 0) & (scene.items[..., 2] > 0) & (squares < (_FARTHEST + 5.0) ** 2)
    order = np.argsort(np.where(matters, squares, np.inf), axis=1, kind="stable")[:, :_ITEMS]
    spots = scene.items[rows, order]
    worth = np.where(matters, worth, 0)[rows, order]
    at = scene.road.place(spots)
    is_kept = (at.along > _NEAREST) & (at.along < _FARTHEST) & (np.abs(at.above) < _LEVEL)
    is_kept &= np.abs(at.across) < at.half_widths + _BEYOND
    items = np.empty((*worth.shape, 4))
    items[..., 0], items[..., 1] = at.along, at.across
    items[..., 2] = np.where(is_kept, worth, 0)
    radii = np.array([rules.bad_item_radius, rules.item_radius], np.float32)
    items[..., 3] = radii[(worth > 0).astype(np.intp)]
    return items


@lru_cache(maxsize=64)
def _worths(rules: DriverParameters) -> FloatArray:
    """Returns the worth of item types [m] for karts without and with a powerup, ``(2, types)``."""
    worths = np.zeros((2, max(ItemType) + 3), np.float32)
    worths[:, ItemType.BONUS_BOX] = rules.box_worth, rules.second_box_worth
    worths[:, ItemType.NITRO_BIG] = rules.big_nitro_worth
    worths[:, ItemType.NITRO_SMALL] = rules.small_nitro_worth
    worths[:, ItemType.BANANA] = -rules.banana_cost
    worths[:, ItemType.BUBBLEGUM] = -rules.gum_cost
    return worths
