"""The heuristic driver: aim at the road ahead, slide through long curves, get unstuck."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo import PowerupType

from .items import aim_for_items
from .line import CentreLine
from .parameters import DriverParameters

__all__ = ["DriverState", "HeuristicDriver"]

FloatArray = npt.NDArray[np.float64]
Action = dict[str, Any]

#: Where the line's curvature is measured, from the kart on [m].
_CURVE_MARKS = np.linspace(0.0, 72.0, 13)

#: Inside a drift the engine turns by this share of full lock ...
_DRIFT_LEAST_TURN = 0.2
#: ... and by so much more as steer goes from -1 to 1.
_DRIFT_TURN_RANGE = 0.6

#: The race starts with this phase (``stkzoo.Phase.GO_PHASE``).
_GO_PHASE = 2


@dataclass(slots=True)
class DriverState:
    """What the driver remembers in one race. Times in steps.

    Attributes:
        steps: calls so far.
        drift_side: 1 in a drift to the right, -1 to the left, 0 in none.
        drift_steps: how long the drift has lasted.
        still_steps: how long the kart has stood still.
        reverse_steps: how much longer to back out.
        reverses: how often it has backed out without getting away.
        free_steps: how long it has been driving.
    """

    steps: int = 0
    drift_side: int = 0
    drift_steps: int = 0
    still_steps: int = 0
    reverse_steps: int = 0
    reverses: int = 0
    free_steps: int = 0


@dataclass(frozen=True, slots=True)
class _Situation:
    """One moment as the driver judges it: the aim and what it takes to reach it."""

    speed: float  # forward [m/s]
    angle: float  # of the aim, positive to the right [rad]
    wheel: float  # wanted share of full lock, not clipped, positive to the right
    bends: FloatArray  # curvature of the line ahead at _CURVE_MARKS, positive to the right [1/m]
    full_lock: float  # curvature of the kart's way at full lock [1/m]


@dataclass(frozen=True, slots=True)
class HeuristicDriver:
    """Drives a kart by the ``full`` view alone.

    Args:
        parameters: the numbers that it goes by.
    """

    parameters: DriverParameters = field(default_factory=DriverParameters)

    def __call__(self, state: DriverState, observation: Mapping[str, Any]) -> Action:
        """Picks an action, and keeps ``state`` up to date.

        Args:
            state: of this race, made by ``create_state``.
            observation: of the ``full`` view.

        Returns:
            An action of the ``full`` view.
        """
        state.steps += 1
        situation = self._judge(observation)
        if state.reverse_steps > 0:
            return self._back_out(state, situation)
        if self._is_stuck(state, situation, observation):
            return self._get_unstuck(state, situation)
        return self._race(state, situation, observation)

    def _judge(self, observation: Mapping[str, Any]) -> _Situation:
        rules = self.parameters
        line = CentreLine.of(observation)
        speed = float(observation["velocity"][2])
        aim = aim_for_items(_aim(line, speed, rules), line, observation, rules)
        distance = max(math.hypot(aim[0], aim[2]), 1.0)
        angle = math.atan2(aim[0], aim[2])
        turn = math.atan(rules.wheel_base * 2.0 * math.sin(angle) / distance)
        if abs(angle) > math.pi / 2:
            turn = math.copysign(math.pi / 4, angle)
        max_turn = max(float(observation["max_steer_angle"][0]), 0.02)
        wheel = rules.steer_gain * turn / max_turn
        full_lock = math.tan(max_turn) / rules.wheel_base
        return _Situation(speed, angle, wheel, _bends(line.at(_CURVE_MARKS)), full_lock)

    def _race(self, state: DriverState, now: _Situation, observation: Mapping[str, Any]) -> Action:
        rules = self.parameters
        self._choose_drift(state, now)
        too_sharp = abs(now.angle) > rules.brake_angle and now.speed > rules.brake_speed
        is_straight = (
            abs(now.bends[:5]).max() < rules.nitro_curvature and abs(now.wheel) < rules.nitro_steer
        )
        can_fire = abs(now.angle) < rules.straight_angle and self._has_use_for_powerup(observation)
        return _action(
            acceleration=0.0 if too_sharp else 1.0,
            steer=_drift_steer(state.drift_side, now.wheel) if state.drift_side else now.wheel,
            brake=too_sharp,
            drift=state.drift_side != 0,
            nitro=is_straight and now.speed > rules.nitro_min_speed,
            fire=can_fire and state.steps % rules.fire_every == 0,
        )

    def _has_use_for_powerup(self, observation: Mapping[str, Any]) -> bool:
        """Whether there is something to fire; the switch would spoil good items close ahead."""
        if observation["powerup_type"] == PowerupType.SWITCH and observation["items_position"]:
            nearest = observation["items_position"][0]
            if 0.0 < nearest[2] < self.parameters.item_reach:
                return False
        return bool(observation["powerup_count"] > 0)

    # ------------------------------------------------------------------ drifting

    def _choose_drift(self, state: DriverState, now: _Situation) -> None:
        """Starts, keeps or ends the drift."""
        rules = self.parameters
        if state.drift_side:
            state.drift_steps += 1
            if self._drift_is_over(state, now):
                state.drift_side = 0
            return
        side = int(np.sign(now.bends[0]))
        if (
            now.speed > rules.drift_start_speed
            and rules.drift_min_turn < self._turn_share(now) * side < rules.drift_max_turn
            and rules.drift_min_steer < now.wheel * side < rules.drift_max_steer
            and self._curve_time(now, side) > rules.drift_min_time
        ):
            state.drift_side, state.drift_steps = side, 0

    def _drift_is_over(self, state: DriverState, now: _Situation) -> bool:
        rules = self.parameters
        inwards = now.wheel * state.drift_side
        has_bonus = state.drift_steps * rules.step_size > rules.drift_bonus_time
        return (
            state.drift_steps * rules.step_size > rules.drift_max_time
            or now.speed < rules.drift_stop_speed
            or inwards > rules.drift_tight_steer
            or inwards < (rules.drift_bonus_steer if has_bonus else rules.drift_counter_steer)
            or self._curve_time(now, state.drift_side) < rules.drift_end_time
        )

    def _turn_share(self, now: _Situation) -> float:
        """The share of full lock that the near curve takes on average, positive to the right."""
        length = now.speed * self.parameters.drift_look_time
        near = now.bends[: max(int(length / _CURVE_MARKS[1]) + 1, 2)]
        return float(near.mean()) / now.full_lock

    def _curve_time(self, now: _Situation, side: int) -> float:
        """How long the line goes on bending to a side [s]."""
        is_curve = now.bends * side > self.parameters.curve_curvature
        length = _CURVE_MARKS[1] * (len(is_curve) if is_curve.all() else is_curve.argmin())
        return float(length) / max(now.speed, 1.0)

    # ------------------------------------------------------------------ getting unstuck

    def _is_stuck(
        self, state: DriverState, now: _Situation, observation: Mapping[str, Any]
    ) -> bool:
        rules = self.parameters
        has_started = observation["phase"] >= _GO_PHASE
        if has_started and abs(now.speed) < rules.stuck_speed:
            state.still_steps += 1
            state.free_steps = 0
        else:
            state.still_steps = 0
            state.free_steps += 1
        if state.free_steps * rules.step_size > rules.free_time:
            state.reverses = 0
        return state.still_steps * rules.step_size > rules.stuck_time

    def _get_unstuck(self, state: DriverState, now: _Situation) -> Action:
        state.still_steps = state.drift_side = 0
        if state.reverses >= self.parameters.rescue_reverses:
            state.reverses = 0
            return _action(rescue=True)
        state.reverses += 1
        state.reverse_steps = round(self.parameters.reverse_time / self.parameters.step_size)
        return self._back_out(state, now)

    def _back_out(self, state: DriverState, now: _Situation) -> Action:
        state.reverse_steps -= 1
        return _action(brake=True, steer=-math.copysign(1.0, now.angle))


def _aim(line: CentreLine, speed: float, rules: DriverParameters) -> FloatArray:
    """The farthest point of the line, up to the wanted distance, to which the road leads straight.

    Returns:
        ``(3,)`` [m].
    """
    wanted = rules.aim_distance + rules.aim_time * max(speed, 0.0)
    nearest = min(rules.min_aim_distance, wanted)
    between = np.linspace(0.0, wanted, 10)[1:]
    points = line.at(between)
    room = line.half_width_at(between) - rules.shortcut_margin
    x, z = points[:, 0], points[:, 2]
    lengths = np.hypot(x, z)
    # [i, j]: how far point j of the line lies beside the straight way to point i
    beside = np.abs(np.outer(x, z) - np.outer(z, x)) / np.maximum(lengths, 0.1)[:, None]
    is_blocked = ((beside > room) & np.tri(len(between), k=-1, dtype=bool)).any(axis=1)
    choices = np.flatnonzero(~is_blocked | (between <= nearest))
    return np.array(points[choices[-1] if len(choices) else 0])


def _bends(points: FloatArray) -> FloatArray:
    """Curvature ``(P,)`` [1/m] at points ``(P, 3)`` of a line, positive to the right."""
    steps = np.diff(points[:, [0, 2]], axis=0)
    headings = np.unwrap(np.arctan2(steps[:, 0], steps[:, 1]))
    lengths = np.maximum(np.hypot(steps[:, 0], steps[:, 1]), 0.5)
    inner = np.diff(headings) / ((lengths[1:] + lengths[:-1]) / 2)
    return np.concatenate([inner[:1], inner, inner[-1:]])


def _drift_steer(side: int, wheel: float) -> float:
    """What to send so that a drifting kart turns by a wanted share of full lock."""
    return side * (2.0 * (wheel * side - _DRIFT_LEAST_TURN) / _DRIFT_TURN_RANGE - 1.0)


def _action(
    *,
    acceleration: float = 0.0,
    steer: float = 0.0,
    brake: bool = False,
    drift: bool = False,
    fire: bool = False,
    nitro: bool = False,
    rescue: bool = False,
) -> Action:
    return {
        "acceleration": np.array([acceleration], np.float32),
        "steer": np.array([min(max(steer, -1.0), 1.0)], np.float32),
        "brake": int(brake),
        "drift": int(drift),
        "fire": int(fire),
        "nitro": int(nitro),
        "rescue": int(rescue),
    }
