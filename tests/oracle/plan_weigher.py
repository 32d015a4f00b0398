"""The oracle of ``agents/planning/weigher.c`` in NumPy, which documents the arguments."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning.memory import MARK_SPACING
from stkzoo.agents.planning.motion import (
    BOOST_LASTS,
    BOOST_STEPS,
    BRAKE_TIME,
    RELEASE_STEPS,
    RELEASE_TURN,
    STEP,
    MotionState,
)
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.plans import PlanTable

FloatArray = npt.NDArray[np.float32]
DoubleArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
Arrays = tuple[npt.NDArray[Any], ...]

#: Number of maneuvers with which plans begin, and the maneuver that brakes.
_MANEUVERS, _BRAKE = 4, 1
#: Worth of a maneuver with which no plan begins.
_NEVER = -1e4
#: Largest turn per step [rad] and lowest speed [m/s] of plans simulated by the network.
_MOST_YAW, _LEAST_SPEED = np.float32(0.4), np.float32(2.0)


#: Lag of the wheels behind the steering [fraction of a step].
_LAG = 0.33
_BLUR, _LENGTH, _BESIDE, _HARMLESS, _CROSSING = 0.5, 1.8, 0.5, 1.0, 0.5


def weigh_plans(
    plans: PlanTable,
    rules: DriverParameters,
    motion: Arrays,
    rows: IntArray,
    karts: FloatArray,
    road: FloatArray,
    items: DoubleArray,
    rivals: DoubleArray,
    out: FloatArray,
) -> None:
    """Finds the best plan of each maneuver.

    Args:
        plans: the plans of all states.
        rules: parameters of the plans.
        motion: layers of the network, or nothing for arcs.
        rows: ``(A,)`` states of the karts.
        karts: ``(A, 16)`` the numbers of ``Situation`` in ``planning.h``, in order.
        road: ``(A, 4, M)`` its arrays at the marks.
        items: ``(A, I, 4)`` its items.
        rivals: ``(A, R, 5)`` its rivals.
        out: ``(3, A, 4)``, see ``Best``.
    """
    drive = drive_by_network if motion else drive_arcs
    along, across, rooms, angles, turns = drive(plans, motion, rows, karts, road, items)
    costs, speed = rules, karts[:, 0]
    danger = _danger(plans.spans, across, rooms, angles, speed, costs)
    worth = along[-1] - danger - np.float32(costs.angle_cost) * angles * angles
    worth += _boosts(plans, rows, karts, costs)
    worth += _item_gain(items, along, across)
    if costs.bump_cost:
        worth -= _bumps(plans.spans, rivals, along, across, speed, costs)
    maneuvers = plans.maneuvers[rows]
    may_drift, may_brake = karts[:, 9:10] > 0, karts[:, 10:11] > 0
    is_there = (maneuvers >= 0) & (may_drift | ~plans.needs_drift[rows])
    is_there &= may_brake | (maneuvers != _BRAKE)
    for maneuver in range(_MANEUVERS):
        own = is_there & (maneuvers == maneuver)
        best = np.where(own, worth, _NEVER).argmax(axis=1)[:, None]
        exists = own.any(axis=1)
        for part, (values, missing) in enumerate(((worth, _NEVER), (turns, 0), (danger, 0))):
            found = np.take_along_axis(values, best, axis=1)[:, 0]
            out[part, :, maneuver] = np.where(exists, found, missing)


class _Course:
    """Where the plans of karts steer, and the road at their current positions.

    Args:
        known: the plans.
        rows: see :func:`weigh_plans`.
        karts: see :func:`weigh_plans`.
        road: see :func:`weigh_plans`.
        items: see :func:`weigh_plans`.

    Attributes:
        bend: ``(A, C)`` lateral displacement by the road's bend ahead of each plan [m].
        rooms: ``(2, A, C)`` largest offsets from the middle to the left and to the right [m].
        curvature: ``(A, C)`` curvature of the road [1/m].
    """

    def __init__(
        self,
        known: PlanTable,
        rows: IntArray,
        karts: FloatArray,
        road: FloatArray,
        items: DoubleArray,
    ) -> None:
        lock, self._reach = karts[:, 1:3, None].swapaxes(0, 1)
        # converts a lateral distance to a turn [fraction of full lock], per m/s of speed
        self._pull = 2.0 / (self._reach * self._reach * lock)
        self._least, self._most = known.least[rows], known.most[rows]
        self._lanes, which = known.lanes[rows], known.items[rows]
        lanes = _item_lanes(items, int(which.max()) + 1)
        own = np.take_along_axis(lanes, np.maximum(which, 0), axis=1)
        self._extra = np.where(which < 0, 0, own)
        self._last_mark = road.shape[2] - 1
        self._at_marks = np.ascontiguousarray(road.swapaxes(0, 1)).reshape(4, -1)
        self._first = road.shape[2] * np.arange(len(karts))[:, None]
        self._per_mark = np.float32(1.0 / MARK_SPACING)
        self.reach_to(np.zeros(which.shape, np.float32))

    def reach_to(self, along: FloatArray) -> None:
        """Looks up the road at the distances of the plans ``(A, C)`` [m]."""
        marks = np.clip((along * self._per_mark).astype(np.intp), 0, self._last_mark)
        self.bend, *rooms, self.curvature = self._at_marks.take(self._first + marks, axis=1)
        self.rooms = np.stack(rooms)

    def turn(
        self, stage: int, beside: FloatArray, angle: FloatArray, speed: FloatArray
    ) -> FloatArray:
        """Returns the turns of the plans [fraction of full lock]."""
        lanes, (left, right) = self._lanes[:, stage], self.rooms
        aside = lanes * np.where(lanes > 0, right, left) + self._extra - beside
        turn = (aside + self.bend - angle * self._reach) * (speed * self._pull)
        limited: FloatArray = np.maximum(turn, self._least[:, stage])
        return np.minimum(limited, self._most[:, stage])

    def way(self, step: FloatArray, beside: FloatArray) -> FloatArray:
        """Returns the distance along the road [m]; the inner side of a curve is shorter."""
        inner = np.maximum(1.0 - beside * self.curvature, np.float32(0.3))
        way: FloatArray = step / inner
        return way


def drive_arcs(
    known: PlanTable,
    motion: Arrays,
    rows: IntArray,
    karts: FloatArray,
    road: FloatArray,
    items: DoubleArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Simulates all plans of all karts as arcs at constant speed.

    See :func:`weigh_plans` for the arguments.

    Returns:
        Distances along the road and offsets from its middle, ``(T, A, C)`` each [m]; largest
        offsets to the left and to the right, ``(2, T, A, C)`` [m]; final angles to the road [rad]
        and current turns [fraction of full lock], ``(A, C)`` each.
    """
    del motion
    speed, lock, _, own_turn, drift_turn, offset, own_angle = karts[:, :7, None].swapaxes(0, 1)
    drifts, releases, slower = known.drifts[rows] > 0, known.releases[rows], known.slower[rows]
    course = _Course(known, rows, karts, road, items)
    plans = known.items.shape[1]
    along, across, rooms = _room_for(known, len(rows))
    at = np.zeros((len(rows), plans), np.float32)
    beside, angle, last_turn = (
        np.repeat(x, plans, axis=1) for x in (offset, own_angle, drift_turn)
    )
    turns = last_turn
    for stage, span in enumerate(known.spans):
        speeds = np.maximum(speed + slower[:, stage], 4.0)
        turn = course.turn(stage, beside, angle, speeds)
        last_turn = np.where(drifts[:, stage], turn, last_turn)
        if stage == 0:
            turns = turn
            turn = turn + (own_turn - turn) * np.float32(_LAG)
        release = releases[:, stage] * (np.float32(RELEASE_TURN) / lock)
        turn = (turn + last_turn * release) * (lock * span)
        step = speeds * span
        way = course.way(step, beside)
        turn = 0.5 * (turn - way * course.curvature)
        angle = angle + turn
        at = at + way * np.cos(angle)
        beside = beside + step * np.sin(angle)
        angle = angle + turn
        course.reach_to(at)
        along[stage], across[stage], rooms[:, stage] = at, beside, course.rooms
    return along, across, rooms, angle, turns


def drive_by_network(
    known: PlanTable,
    motion: Arrays,
    rows: IntArray,
    karts: FloatArray,
    road: FloatArray,
    items: DoubleArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Simulates all plans of all karts with the network; see :func:`drive_arcs`."""
    speed, _, _, own_turn, drift_turn, offset, own_angle = karts[:, :7, None].swapaxes(0, 1)
    boost, big_boost = karts[:, 7:9, None].swapaxes(0, 1)
    slide, yaw, drift_side, drift_steps, release = karts[:, 11:, None].swapaxes(0, 1)
    course = _Course(known, rows, karts, road, items)
    along, across, rooms = _room_for(known, len(rows))
    zeros = np.zeros((len(rows), known.items.shape[1]), np.float32)
    at, beside, angle, turns = zeros, zeros + offset, zeros + own_angle, zeros
    of_karts = (drift_side, drift_steps, release, drift_turn, boost, big_boost, 0)
    own = MotionState(*(zeros + x for x in (speed, slide, yaw, own_turn, own_turn, *of_karts)))
    half = np.float32(0.5 * STEP)
    brakers = (known.maneuvers[rows] == _BRAKE).astype(np.float32)
    step = 0
    for stage, end in enumerate(np.cumsum(known.spans, dtype=np.float32)):
        middle = known.least[rows, stage] + known.most[rows, stage]
        side = np.where(known.drifts[rows, stage] > 0, np.sign(middle), 0)
        while np.float32(step) * np.float32(STEP) < end - half:
            turn = course.turn(stage, beside, angle, own.speed)
            turns = turn if step == 0 else turns
            brakes = brakers if step < round(BRAKE_TIME / STEP) else zeros
            own = _act(own, turn, side, brakes, is_first=step == 0)
            yaw, more_speed, more_slide = _infer(motion, own.inputs())
            yaw = np.minimum(np.maximum(yaw, -_MOST_YAW), _MOST_YAW)
            speed = np.maximum(own.speed + more_speed, _LEAST_SPEED)
            slide = own.slide + more_slide
            forward, aside = half * (own.speed + speed), half * (own.slide + slide)
            heading = angle + np.float32(0.5) * yaw
            sine, cosine = np.sin(heading), np.cos(heading)
            way = course.way(forward * cosine - aside * sine, beside)
            at, beside = at + way, beside + (forward * sine + aside * cosine)
            angle = angle + (yaw - way * course.curvature)
            own = own._replace(speed=speed, slide=slide, yaw=yaw)
            course.reach_to(at)
            step += 1
        along[stage], across[stage], rooms[:, stage] = at, beside, course.rooms
    return along, across, rooms, angle, turns


def _room_for(known: PlanTable, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns empty arrays for the stages of all plans of karts.

    Returns:
        Two arrays ``(T, A, C)`` and one ``(2, T, A, C)``.
    """
    arrays = np.empty((4, len(known.spans), count, known.items.shape[1]), np.float32)
    return arrays[0], arrays[1], arrays[2:]


def _act(
    own: MotionState,
    turn: FloatArray,
    side: FloatArray,
    brake: FloatArray,
    *,
    is_first: bool,
) -> MotionState:
    """Returns the state of karts, with their drivers' memory updated for a step of the plans."""
    aged = 0 if is_first else 1
    release, boost, big_boost = (
        np.maximum(left - aged, 0) for left in (own.release, own.boost, own.big_boost)
    )
    ends, begins = (own.side != 0) & (side == 0), (side != 0) & (own.side == 0)
    is_big = ends & (own.steps >= BOOST_STEPS[1])
    is_small = ends & ~is_big & (own.steps >= BOOST_STEPS[0])
    return own._replace(
        turn=turn,
        turn_before=own.turn,
        side=side,
        steps=np.where(side != 0, np.where(begins, 0, own.steps) + 1, 0),
        release=np.where(ends, np.minimum(own.steps, RELEASE_STEPS), release),
        drift_turn=np.where(side != 0, turn, own.drift_turn),
        boost=np.where(is_small, BOOST_LASTS[0], boost),
        big_boost=np.where(is_big, BOOST_LASTS[1], big_boost),
        brake=brake,
    )


def _infer(layers: Arrays, inputs: FloatArray) -> FloatArray:
    """Returns the outputs of the network, ``(3, A, C)``."""
    x = inputs
    for matrix, bias in zip(layers[:-2:2], layers[1:-2:2], strict=True):
        x = np.maximum(x @ matrix.T + bias, 0)
    outputs: FloatArray = np.moveaxis(x @ layers[-2].T + layers[-1], -1, 0)
    return outputs.astype(np.float32)


def _item_lanes(items: DoubleArray, count: int) -> FloatArray:
    """Returns the offsets of the next good items from the middle, ``(A, count)`` [m]."""
    is_good = items[..., 2] > 0
    order = np.argsort(~is_good, axis=1, kind="stable")[:, :count]
    across = np.take_along_axis(np.where(is_good, items[..., 1], 0), order, axis=1)
    lanes = np.zeros((len(items), count), np.float32)
    lanes[:, : across.shape[1]] = across
    return lanes


def _danger(
    spans: FloatArray,
    across: FloatArray,
    rooms: FloatArray,
    angles: FloatArray,
    speed: FloatArray,
    rules: DriverParameters,
) -> FloatArray:
    """Returns the cost of leaving the road, ``(A, C)`` [m]."""
    left, right = rooms
    over = np.maximum(np.maximum(across - right, -across - left), 0)
    out = across[-1] + angles * (speed * np.float32(rules.late_time))[:, None]
    late = np.maximum(np.maximum(out - right[-1], -out - left[-1]), 0)
    cost: FloatArray = np.tensordot(spans, over, axes=1) * np.float32(rules.over_cost)
    cost += np.float32(rules.late_cost) * late
    return cost


def _boosts(
    table: PlanTable, rows: IntArray, karts: FloatArray, rules: DriverParameters
) -> FloatArray:
    """Returns the gain from the boosts of drifts, ``(A, C)`` [m].

    The gain is smaller while an earlier boost of the same kind lasts.
    """
    wait, boosts = table.boost_steps[rows], table.boosts[rows]
    fresh = np.minimum(1.0 - (karts[:, 7:8] - wait) / BOOST_LASTS[0], 1.0)
    fresh_big = np.minimum(1.0 - (karts[:, 8:9] - wait) / BOOST_LASTS[1], 1.0)
    worth = np.where(boosts == 1, fresh_big * rules.big_boost_worth, fresh * rules.boost_worth)
    worth -= rules.boost_wait_cost * STEP * wait
    return np.where(boosts < 0, 0.0, np.maximum(worth, 0.0)).astype(np.float32)


def _item_gain(items: DoubleArray, along: FloatArray, across: FloatArray) -> FloatArray:
    """Returns the gain from the items that plans hit, ``(A, C)`` [m]."""
    gain: FloatArray = np.zeros(along.shape[1:], np.float32)
    for item in range(items.shape[1]):
        who = np.flatnonzero(items[:, item, 2])
        if not len(who):
            continue
        own_along, own_across = along[:, who], across[:, who]
        there, beside, worth, radius = items[who, item, :, None].swapaxes(0, 1)
        passed = np.greater_equal(own_along, there)
        stage = passed.argmax(axis=0)
        before = np.maximum(stage - 1, 0)
        rows, columns = np.arange(len(who))[:, None], np.arange(gain.shape[1])
        from_, to = own_along[before, rows, columns], own_along[stage, rows, columns]
        share = np.clip((there - from_) / np.maximum(to - from_, 1e-3), 0.0, 1.0)
        start, end = own_across[before, rows, columns], own_across[stage, rows, columns]
        miss = np.abs(start + (end - start) * share - beside)
        hit = np.clip((radius - miss) / _BLUR + 1.0, 0.0, 1.0)
        gain[who] += worth * hit * passed[-1]
    return gain


def _bumps(
    spans: FloatArray,
    rivals: DoubleArray,
    along: FloatArray,
    across: FloatArray,
    speed: FloatArray,
    rules: DriverParameters,
) -> FloatArray:
    """Returns the cost of running into slower karts ahead, ``(A, C)`` [m]."""
    cost: FloatArray = np.zeros(along.shape[1:], np.float32)
    ends = np.cumsum(spans)
    crossing = np.minimum(ends, _CROSSING)[:, None]
    closing = -rivals[..., 3].astype(np.float32)
    matters = (rivals[..., 0] > 0) & (rivals[..., 1] > _BESIDE)
    matters &= closing > _HARMLESS
    matters &= rivals[..., 1] < closing * ends[-1] + _LENGTH
    for rival in range(matters.shape[1]):
        who = np.flatnonzero(matters[:, rival])
        if not len(who):
            continue
        own = closing[who, rival]
        there, aside, drift = (rivals[who, rival, column] for column in (1, 2, 4))
        ahead = there + (speed[who] - own) * ends[:, None]
        beside = aside.astype(np.float32) + drift.astype(np.float32) * crossing
        reached = ahead[..., None] - along[:, who] < _LENGTH
        stage = reached.argmax(axis=0)
        rows, columns = np.arange(len(who))[:, None], np.arange(cost.shape[1])
        gap = np.abs(across[stage, who[:, None], columns] - beside[stage, rows])
        hit = np.clip((np.float32(rules.bump_width) - gap) / _BLUR, 0.0, 1.0)
        cost[who] += np.float32(rules.bump_cost) * own[:, None] * hit * reached.any(axis=0)
    return cost
