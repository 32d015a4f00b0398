"""Weighs plans for the next two seconds, for any number of karts at once.

For each kart a few dozen plans (:mod:`.plans`) are driven over the road ahead by a simple model of
a kart. What comes of it is put together by what a plan begins with: go on, brake, drift to the
left, drift to the right. A learned policy sees the best of each and chooses among them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stkzoo.mdp.geometry import squared
from stkzoo.names import ItemType, PowerupType

from .kart import BOOST_LASTS, RELEASE_TURN, STEERING_LAG, STEP
from .memory import KartSituation
from .parameters import DriverParameters
from .plans import (
    BRAKE,
    ENDS,
    ITEM_LANES,
    MANOEUVRES,
    SPANS,
    PlanTable,
    plan_table,
    table_rows,
)
from .rivals import Rivals
from .road import MARK_COUNT, MARK_SPACING, RoadAhead

__all__ = ["ITEMS", "NEVER", "PlanOptions", "PlanScene", "has_powerup", "weigh"]

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]

#: Items weighed.
ITEMS = 8
#: An item on another level of the track is farther above or below than this [m].
_LEVEL = 4.0
#: Items nearer than this cannot be steered for any more, farther ones are out of sight [m].
_NEAREST, _FARTHEST = 1.0, 60.0
#: Items this far beyond the edge of the road are not on it [m].
_BEYOND = 1.0
#: A miss by so much more than the radius earns nothing [m].
_BLUR = 0.5

#: The centres of karts that run into one another are so far apart [m].
_LENGTH = 1.8
#: Who is less far ahead is beside [m]; to come nearer at less than this does no harm [m/s].
_BESIDE, _HARMLESS = 0.5, 1.0
#: For how long until a moment's end rivals go on across the road as they do now [s].
_CROSSING = np.minimum(ENDS, 0.5)

#: Karts are taken to be at least so fast [m/s].
_SLOWEST = 5.0
#: The worth of a manoeuvre that there is not.
NEVER = -1e4


@dataclass(frozen=True, slots=True)
class PlanScene:
    """What A karts see that bears on plans.

    Attributes:
        speed: ``(A,)`` forward [m/s].
        max_steer_angle: ``(A,)`` [rad].
        is_jumping: ``(A,)``.
        has_powerup: ``(A,)``.
        road: what lies ahead.
        items: ``(A, M, 3)`` in the kart's frame [m].
        item_types: ``(A, M)`` numbers of :class:`~stkzoo.names.ItemType`; others are none.
        rivals: the nearest karts.
    """

    speed: FloatArray
    max_steer_angle: FloatArray
    is_jumping: BoolArray
    has_powerup: BoolArray
    road: RoadAhead
    items: FloatArray
    item_types: npt.NDArray[np.integer]
    rivals: Rivals


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """The best plan of each manoeuvre, ``(A, 4)`` each; and the road.

    Attributes:
        worth: what it is worth [m]; :data:`NEVER` where there is none.
        turn: the share of full lock to turn by now, positive to the right.
        danger: what it costs beyond the edge of the road [m].
        angle: ``(A,)`` the kart's direction, 0 is the road's [rad].
        offset: ``(A,)`` how far it is from the middle, positive to the right [m].
        beyond: ``(A,)`` how far it is beyond the edge of the road, negative on it [m].
        straightness: ``(A,)`` by how much the road turns at most in a while [rad].
    """

    worth: FloatArray
    turn: FloatArray
    danger: FloatArray
    angle: FloatArray
    offset: FloatArray
    beyond: FloatArray
    straightness: FloatArray


@dataclass(frozen=True, slots=True)
class _Items:
    """The items ahead that matter, nearest first, ``(A, I)`` each; of worth 0 where none is."""

    along: FloatArray
    across: FloatArray
    worth: FloatArray
    radius: FloatArray

    @classmethod
    def of(cls, scene: PlanScene, road: RoadAhead, rules: DriverParameters) -> _Items:
        worths = _worths(scene, rules)
        types = np.clip(scene.item_types, -1, max(ItemType) + 1)
        worth = np.take_along_axis(worths, types % worths.shape[1], axis=1)
        squares = squared(scene.items)
        matters = (worth != 0) & (scene.items[..., 2] > 0) & (squares < (_FARTHEST + 5.0) ** 2)
        order = np.argsort(np.where(matters, squares, np.inf), axis=1, kind="stable")[:, :ITEMS]
        spots = np.take_along_axis(scene.items, order[..., None], axis=1)
        worth = np.take_along_axis(np.where(matters, worth, 0), order, axis=1)
        at = road.place(spots)
        is_kept = (at.along > _NEAREST) & (at.along < _FARTHEST) & (np.abs(at.above) < _LEVEL)
        is_kept &= np.abs(at.across) < at.half_widths + _BEYOND
        worth = np.where(is_kept, worth, 0).astype(np.float32)
        radius = np.where(worth > 0, rules.item_radius, rules.bad_item_radius)
        return cls(at.along, at.across, worth, radius.astype(np.float32))

    def lanes(self) -> FloatArray:
        """How far across the road the next good items are, ``(A, ITEM_LANES)`` [m]."""
        is_good = self.worth > 0
        order = np.argsort(~is_good, axis=1, kind="stable")[:, :ITEM_LANES]
        across = np.take_along_axis(np.where(is_good, self.across, 0), order, axis=1)
        lanes = np.zeros((len(across), ITEM_LANES), np.float32)
        lanes[:, : across.shape[1]] = across
        return lanes


def _worths(scene: PlanScene, rules: DriverParameters) -> FloatArray:
    """What items are worth to each kart by type, ``(A, types)`` [m]."""
    worths = np.zeros((len(scene.speed), max(ItemType) + 3), np.float32)
    worths[:, ItemType.BONUS_BOX] = np.where(
        scene.has_powerup, rules.second_box_worth, rules.box_worth
    )
    worths[:, ItemType.NITRO_BIG] = rules.big_nitro_worth
    worths[:, ItemType.NITRO_SMALL] = rules.small_nitro_worth
    worths[:, ItemType.BANANA] = -rules.banana_cost
    worths[:, ItemType.BUBBLEGUM] = -rules.gum_cost
    return worths


def weigh(scene: PlanScene, now: KartSituation, rules: DriverParameters) -> PlanOptions:
    """The best plan of each manoeuvre.

    Args:
        scene: what the karts see.
        now: what they are in the middle of.
        rules: what plans are worth.
    """
    road, table = scene.road, plan_table(rules.lane_changes)
    rows = table_rows(now.drift_side, now.drift_steps, now.release_steps)
    speed = np.maximum(scene.speed, _SLOWEST)
    items = _Items.of(scene, road, rules)
    along, across, ahead, angles, turns = _forecast(scene, now, items, table, rows, speed, rules)
    danger = _danger(across, ahead, angles, speed, rules)
    worth = along[-1] - danger - np.float32(rules.angle_cost) * angles * angles
    worth += _boosts(now, table, rows, rules)
    worth += _item_gain(items, along, across)
    if rules.bump_cost:
        worth -= _bumps(scene.rivals, along, across, speed, rules)
    manoeuvres = table.manoeuvres[rows]
    may_drift = (scene.speed > rules.drift_speed) & ~scene.is_jumping & now.may_hop
    may_brake = scene.speed > rules.brake_speed
    is_there = (manoeuvres >= 0) & (may_drift[:, None] | ~table.needs_drift[rows])
    is_there &= may_brake[:, None] | (manoeuvres != BRAKE)
    best = np.empty((len(rows), MANOEUVRES), np.intp)
    for manoeuvre in range(MANOEUVRES):
        own = np.where(is_there & (manoeuvres == manoeuvre), worth, NEVER)
        best[:, manoeuvre] = own.argmax(axis=1)
    exists = np.stack(
        [(is_there & (manoeuvres == m)).any(axis=1) for m in range(MANOEUVRES)], axis=1
    )
    take = np.take_along_axis
    return PlanOptions(
        worth=np.where(exists, take(worth, best, axis=1), NEVER).astype(np.float32),
        turn=np.where(exists, take(turns, best, axis=1), 0).astype(np.float32),
        danger=np.where(exists, take(danger, best, axis=1), 0).astype(np.float32),
        angle=road.angle,
        offset=road.offset,
        beyond=np.abs(road.offset) - road.half_widths[:, 0],
        straightness=road.straightness(rules.straight_time * scene.speed),
    )


def _forecast(
    scene: PlanScene,
    now: KartSituation,
    items: _Items,
    table: PlanTable,
    rows: IntArray,
    speed: FloatArray,
    rules: DriverParameters,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Drives all plans of all karts: along, across, room ``(T, A, C)``; angles, turns ``(A, C)``.

    A kart steers for a point of its lane ahead, as far as its plan lets it.
    """
    road = scene.road
    lock = speed * np.tan(np.maximum(scene.max_steer_angle, 0.02)) / np.float32(rules.wheel_base)
    reach = (rules.aim_distance + rules.aim_time * speed).astype(np.float32)
    widest = np.where(now.is_cautious, rules.caution_room, rules.greatest_room)
    room = np.minimum(np.maximum(road.half_widths - rules.margin, 0.3), widest[:, None])
    at_marks = np.stack(
        [road.bends(reach) * (0.5 * reach * reach)[:, None], room, road.curvature]
    ).astype(np.float32)
    # what turns into a share of full lock, for each m/s of speed
    pull = (2.0 / (reach * reach * lock))[:, None]
    ratio = reach[:, None]
    least, most = table.least[rows], table.most[rows]
    drifts, releases, slower = table.drifts[rows] > 0, table.releases[rows], table.slower[rows]
    lanes, which = table.lanes[rows], table.items[rows]
    extra = np.where(which < 0, 0, np.take_along_axis(items.lanes(), np.maximum(which, 0), axis=1))
    moments, (count, plans) = len(SPANS), which.shape
    along, across, ahead = (np.empty((moments, count, plans), np.float32) for _ in range(3))
    at = np.zeros((count, plans), np.float32)
    beside = np.repeat(road.offset[:, None], plans, axis=1)
    angle = np.repeat(road.angle[:, None], plans, axis=1)
    last_turn = np.repeat(now.drift_turn[:, None], plans, axis=1)
    at_marks = at_marks.reshape(len(at_marks), -1)
    first = MARK_COUNT * np.arange(count)[:, None]
    marks = np.repeat(first, plans, axis=1)
    turns = last_turn
    for moment in range(moments):
        bend, width, curvature = at_marks.take(marks, axis=1)
        if moment:
            ahead[moment - 1] = width
        speeds = np.maximum(speed[:, None] + slower[:, moment], 4.0)
        turn = (lanes[:, moment] * width + extra - beside + bend - angle * ratio) * (speeds * pull)
        turn = np.minimum(np.maximum(turn, least[:, moment]), most[:, moment])
        last_turn = np.where(drifts[:, moment], turn, last_turn)
        if moment == 0:
            turns = turn
            turn = turn + (now.turn[:, None] - turn) * np.float32(STEERING_LAG)
        release = releases[:, moment] * (np.float32(RELEASE_TURN) / lock)[:, None]
        turn = (turn + last_turn * release) * (lock[:, None] * SPANS[moment])
        # along the road the inner side of a curve is the shorter one
        step = speeds * SPANS[moment]
        way = step / np.maximum(1.0 - beside * curvature, 0.3)
        turn = 0.5 * (turn - way * curvature)
        angle = angle + turn
        at = at + way * np.cos(angle)
        beside = beside + step * np.sin(angle)
        angle = angle + turn
        along[moment], across[moment] = at, beside
        marks = (at * np.float32(1.0 / MARK_SPACING)).astype(np.intp)
        marks = first + np.minimum(np.maximum(marks, 0), MARK_COUNT - 1)
    ahead[-1] = at_marks[1].take(marks)
    return along, across, ahead, angle, turns


def _danger(
    across: FloatArray,
    ahead: FloatArray,
    angles: FloatArray,
    speed: FloatArray,
    rules: DriverParameters,
) -> FloatArray:
    """What plans cost by leaving the road, ``(A, C)`` [m]."""
    over = np.maximum(np.abs(across) - ahead, 0)
    out = across[-1] + angles * (speed * np.float32(rules.late_time))[:, None]
    late = np.maximum(np.abs(out) - ahead[-1], 0)
    cost: FloatArray = np.tensordot(SPANS, over, axes=1) * np.float32(rules.over_cost)
    cost += np.float32(rules.late_cost) * late
    return cost


def _boosts(
    now: KartSituation, table: PlanTable, rows: IntArray, rules: DriverParameters
) -> FloatArray:
    """What plans earn by drifting, ``(A, C)`` [m]: less while such a boost still lasts."""
    small, big = BOOST_LASTS
    wait, boosts = table.boost_steps[rows], table.boosts[rows]
    fresh = np.minimum(1.0 - (now.boost_steps[:, None] - wait) / small, 1.0) * rules.boost_worth
    fresh_big = np.minimum(1.0 - (now.big_boost_steps[:, None] - wait) / big, 1.0)
    worth = np.where(boosts == 1, fresh_big * rules.big_boost_worth, fresh)
    worth -= (rules.boost_wait_cost * STEP) * wait
    return np.where(boosts < 0, 0.0, np.maximum(worth, 0.0)).astype(np.float32)


def _item_gain(items: _Items, along: FloatArray, across: FloatArray) -> FloatArray:
    """What plans earn by the items on their way, ``(A, C)`` [m]."""
    gain: FloatArray = np.zeros(along.shape[1:], np.float32)
    last = len(along) - 1
    for item in range(items.worth.shape[1]):
        who = np.flatnonzero(items.worth[:, item])
        if not len(who):
            continue
        own_along, own_across = along[:, who], across[:, who]
        there, beside = items.along[who, item][:, None], items.across[who, item][:, None]
        passed = np.greater_equal(own_along, there)
        moment = passed.argmax(axis=0)
        before = np.maximum(moment - 1, 0)
        rows, columns = np.arange(len(who))[:, None], np.arange(gain.shape[1])
        from_, to = own_along[before, rows, columns], own_along[moment, rows, columns]
        share = np.clip((there - from_) / np.maximum(to - from_, 1e-3), 0.0, 1.0)
        start, end = own_across[before, rows, columns], own_across[moment, rows, columns]
        miss = np.abs(start + (end - start) * share - beside)
        hit = np.clip((items.radius[who, item][:, None] - miss) / _BLUR + 1.0, 0.0, 1.0)
        gain[who] += items.worth[who, item][:, None] * hit * passed[last]
    return gain


def _bumps(
    rivals: Rivals,
    along: FloatArray,
    across: FloatArray,
    speed: FloatArray,
    rules: DriverParameters,
) -> FloatArray:
    """What plans cost by running into slower karts ahead, ``(A, C)`` [m]."""
    cost: FloatArray = np.zeros(along.shape[1:], np.float32)
    closing = -rivals.gain
    matters = rivals.is_there & (rivals.along > _BESIDE) & (closing > _HARMLESS)
    matters &= rivals.along < closing * ENDS[-1] + _LENGTH
    for rival in range(matters.shape[1]):
        who = np.flatnonzero(matters[:, rival])
        if not len(who):
            continue
        ahead = rivals.along[who, rival] + (speed - closing[:, rival])[who] * ENDS[:, None]
        beside = rivals.across[who, rival] + rivals.drift[who, rival] * _CROSSING[:, None]
        reached = ahead[..., None] - along[:, who] < _LENGTH
        moment = reached.argmax(axis=0)
        rows, columns = np.arange(len(who))[:, None], np.arange(cost.shape[1])
        gap = np.abs(across[moment, who[:, None], columns] - beside[moment, rows])
        hit = np.clip((np.float32(rules.bump_width) - gap) / _BLUR, 0.0, 1.0) * reached.any(axis=0)
        cost[who] += np.float32(rules.bump_cost) * closing[who, rival][:, None] * hit
    return cost


def has_powerup(powerup_type: npt.NDArray[np.integer]) -> BoolArray:
    """Which karts have something to fire, ``(A,)``."""
    return np.asarray(powerup_type != PowerupType.NOTHING)
