"""The heuristic driver: weighs plans for the next two seconds, and begins the best one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo import PowerupType
from stkzoo.agents.planning import DriverParameters
from stkzoo.agents.planning.kart import (
    BOOST_LASTS,
    BOOST_STEPS,
    DRIFT_APART,
    DRIFT_TURN,
    RELEASE_STEPS,
    RESCUE_STEPS,
    STEP,
)

from .forecast import Forecast, Motion, forecast
from .items import RoadItems
from .line import CentreLine
from .plans import ITEM_LANES, SPANS, Plans, plans_in_drift, plans_without_drift
from .road import Road

__all__ = ["DriverState", "HeuristicDriver", "Move"]

FloatArray = npt.NDArray[np.float64]
Action = dict[str, Any]

#: The race starts with this phase (``stkzoo.Phase.GO_PHASE``).
_GO_PHASE = 2

#: The engine has ended a drift if the skid factor is still 1 after so many steps.
_DRIFT_SHOWS = 4

#: A drift begins to the side of steer, which must not be too small to tell.
_START_STEER = 0.3

#: Karts are taken to be at least so fast [m/s].
_SLOWEST = 5.0

_NO_LANES = np.zeros(ITEM_LANES)


@dataclass(frozen=True, slots=True)
class Move:
    """What a plan does now.

    Attributes:
        turn: by which share of full lock it turns, positive to the right.
        side: 1 for a drift to the right, -1 to the left, 0 for none.
        brake: whether it brakes.
        danger: what the plan costs beyond the edge of the road [m].
    """

    turn: float
    side: int
    brake: bool
    danger: float


@dataclass(slots=True)
class DriverState:
    """What the driver remembers in one race. Times in steps.

    Attributes:
        steps: calls so far.
        speed: at the last call [m/s].
        turn: the share of full lock of the last call, positive to the right.
        drift_turn: the same of the last call in a drift.
        drift_side: 1 in a drift to the right, -1 to the left, 0 in none.
        drift_steps: how long the drift has lasted.
        hop_steps: how much longer no drift can begin.
        release_steps: how much longer the kart turns after a drift.
        boost_steps: how much longer the boost of a short drift lasts.
        big_boost_steps: how much longer that of a long one lasts.
        nitro_steps: how much longer to wait with nitro.
        last_shot: call of the last shot.
        caution_steps: how much longer to be careful.
        still_steps: how long the kart has stood still.
        crawl_steps: how long it has been very slow.
        reverse_steps: how much longer to back out.
        reverses: how often it has backed out without getting away.
        rescue_steps: how much longer a rescue that was called may take.
        free_steps: how long it has been driving.
        on_road: call in which it was last on the road, or near it.
    """

    steps: int = 0
    speed: float = 0.0
    turn: float = 0.0
    drift_turn: float = 0.0
    drift_side: int = 0
    drift_steps: int = 0
    hop_steps: int = 0
    release_steps: int = 0
    boost_steps: int = 0
    big_boost_steps: int = 0
    nitro_steps: int = 0
    last_shot: int = 0
    caution_steps: int = 0
    still_steps: int = 0
    crawl_steps: int = 0
    reverse_steps: int = 0
    reverses: int = 0
    rescue_steps: int = 0
    free_steps: int = 0
    on_road: int = 0


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
        speed = float(observation["velocity"][2])
        self._remember(state, speed, observation)
        road = Road.of(CentreLine.of(observation))
        if state.reverse_steps > 0:
            return self._back_out(state, road)
        if self._is_lost(state, road):
            return self._call_rescue(state)
        if (
            state.still_steps * STEP > self.parameters.stuck_time
            or state.crawl_steps * STEP > self.parameters.crawl_time
        ):
            return self._get_unstuck(state, road)
        return self._race(state, road, speed, observation)

    def _remember(self, state: DriverState, speed: float, observation: Mapping[str, Any]) -> None:
        """One step has passed."""
        rules = self.parameters
        state.steps += 1
        for name in _CLOCKS:
            setattr(state, name, max(getattr(state, name) - 1, 0))
        if state.speed - speed > rules.crash_drop:
            state.caution_steps = round(rules.caution_time / STEP)
        state.speed = speed
        is_racing = observation["phase"] >= _GO_PHASE and state.rescue_steps == 0
        if is_racing and abs(speed) < rules.stuck_speed:
            state.still_steps += 1
            state.free_steps = 0
        else:
            state.still_steps = 0
            state.free_steps += 1
        crawls = is_racing and abs(speed) < rules.crawl_speed
        state.crawl_steps = state.crawl_steps + 1 if crawls else 0
        if state.free_steps * STEP > rules.free_time:
            state.reverses = 0
        if state.drift_steps >= _DRIFT_SHOWS and observation["skeed_factor"][0] <= 1.0:
            state.drift_side = state.drift_steps = 0

    def _race(
        self, state: DriverState, road: Road, speed: float, observation: Mapping[str, Any]
    ) -> Action:
        rules = self.parameters
        move = self._choose(state, road, speed, observation)
        is_safe = move.danger < rules.danger and not move.brake
        nitro = (
            is_safe
            and state.nitro_steps == 0
            and speed > rules.nitro_speed
            and abs(move.turn) < rules.nitro_turn
            and bool(observation["energy"][0] > 0.0)
            and not observation["jumping"]
        )
        if nitro:
            state.nitro_steps = round(rules.nitro_wait / STEP)
        is_straight = (
            abs(road.angle) < rules.straight_aim
            and road.straightness(rules.straight_time * speed) < rules.straight_angle
        )
        fire = (
            is_safe
            and is_straight
            and state.steps - state.last_shot >= rules.fire_every
            and self._has_use_for_powerup(observation)
        )
        if fire:
            state.last_shot = state.steps
        return self._act(state, move, nitro=nitro, fire=fire)

    def _act(
        self, state: DriverState, move: Move, *, nitro: bool = False, fire: bool = False
    ) -> Action:
        return _action(
            acceleration=0.0 if move.brake else 1.0,
            steer=self._follow(state, move),
            brake=move.brake,
            drift=move.side != 0,
            nitro=nitro,
            fire=fire,
        )

    def _has_use_for_powerup(self, observation: Mapping[str, Any]) -> bool:
        """Whether there is something to fire; the switch would spoil good items close ahead."""
        if observation["powerup_type"] == PowerupType.SWITCH and observation["items_position"]:
            nearest = observation["items_position"][0]
            if 0.0 < nearest[2] < self.parameters.switch_reach:
                return False
        return bool(observation["powerup_count"] > 0)

    # ------------------------------------------------------------------ choosing a plan

    def _choose(
        self, state: DriverState, road: Road, speed: float, observation: Mapping[str, Any]
    ) -> Move:
        rules = self.parameters
        if state.drift_side:
            plans = plans_in_drift(
                state.drift_side, min(state.drift_steps, BOOST_STEPS[1]), rules.lane_changes
            )
        else:
            may_drift = (
                speed > rules.drift_speed and not observation["jumping"] and not state.hop_steps
            )
            plans = plans_without_drift(state.release_steps, may_drift, rules.lane_changes)
        may_brake = speed > rules.brake_speed
        speed = max(speed, _SLOWEST)
        lock = speed * math.tan(max(float(observation["max_steer_angle"][0]), 0.02))
        lock /= rules.wheel_base
        items = RoadItems.of(observation, road, rules)
        widest = rules.caution_room if state.caution_steps else rules.greatest_room
        room = np.minimum(np.maximum(road.half_widths - rules.margin, 0.3), widest)
        ways = forecast(
            plans,
            road,
            room,
            Motion(speed, lock, state.turn, state.drift_turn),
            rules.aim_distance + rules.aim_time * speed,
            items.lanes() if items else _NO_LANES,
        )
        danger = self._danger(ways, speed)
        worth = ways.along[-1] - danger - rules.angle_cost * ways.angles * ways.angles
        worth += self._boosts(state, plans)
        if items:
            worth += items.gain(ways)
        if not may_brake:
            worth[plans.brakes] = -np.inf
        best = int(worth.argmax())
        return Move(
            float(ways.turns[best]),
            int(plans.sides[best]),
            bool(plans.brakes[best]),
            float(danger[best]),
        )

    def _danger(self, ways: Forecast, speed: float) -> FloatArray:
        """What plans cost by leaving the road, ``(C,)`` [m]."""
        rules = self.parameters
        over = np.abs(ways.across)
        over -= ways.room
        np.maximum(over, 0.0, out=over)
        late = np.abs(ways.across[-1] + ways.angles * (speed * rules.late_time)) - ways.room[-1]
        cost: FloatArray = rules.over_cost * (SPANS @ over)
        cost += rules.late_cost * np.maximum(late, 0.0)
        return cost

    def _boosts(self, state: DriverState, plans: Plans) -> FloatArray:
        """What plans earn by drifting, ``(C,)`` [m]: less while such a boost still lasts."""
        rules = self.parameters
        small, big = BOOST_LASTS
        wait = plans.boost_steps
        fresh = np.minimum(1.0 - (state.boost_steps - wait) / small, 1.0) * rules.boost_worth
        fresh_big = np.minimum(1.0 - (state.big_boost_steps - wait) / big, 1.0)
        worth = np.where(plans.boosts == 1, fresh_big * rules.big_boost_worth, fresh)
        worth -= (rules.boost_wait_cost * STEP) * wait
        return np.where(plans.boosts < 0, 0.0, np.maximum(worth, 0.0))

    def _follow(self, state: DriverState, move: Move) -> float:
        """What to steer for the plan; begins, keeps or ends the drift."""
        state.turn = move.turn
        if not move.side:
            self._end_drift(state)
            return move.turn
        least, most = DRIFT_TURN
        steer = 2.0 * (move.turn * move.side - least) / (most - least) - 1.0
        if not state.drift_side:
            state.drift_side, state.drift_steps = move.side, 0
            state.hop_steps = DRIFT_APART
            steer = max(steer, _START_STEER)
        state.drift_steps += 1
        state.drift_turn = move.turn
        return move.side * steer

    def _end_drift(self, state: DriverState) -> None:
        if not state.drift_side:
            return
        if state.drift_steps >= BOOST_STEPS[1]:
            state.big_boost_steps = BOOST_LASTS[1]
        elif state.drift_steps >= BOOST_STEPS[0]:
            state.boost_steps = BOOST_LASTS[0]
        state.release_steps = min(state.drift_steps, RELEASE_STEPS)
        state.drift_side = state.drift_steps = 0

    # ------------------------------------------------------------------ getting unstuck

    def _is_lost(self, state: DriverState, road: Road) -> bool:
        rules = self.parameters
        beyond = abs(road.offset) - float(road.half_widths[0])
        if beyond < rules.lost_room or state.rescue_steps > 0:
            state.on_road = state.steps
        return (state.steps - state.on_road) * STEP > rules.lost_time

    def _get_unstuck(self, state: DriverState, road: Road) -> Action:
        if state.reverses >= self.parameters.rescue_reverses:
            return self._call_rescue(state)
        state.drift_side = state.drift_steps = 0
        state.reverses += 1
        state.reverse_steps = round(self.parameters.reverse_time / STEP)
        return self._back_out(state, road)

    def _call_rescue(self, state: DriverState) -> Action:
        state.still_steps = state.crawl_steps = state.drift_side = state.drift_steps = 0
        state.reverses = -self.parameters.rescued_reverses
        state.rescue_steps = RESCUE_STEPS
        return _action(rescue=True)

    def _back_out(self, state: DriverState, road: Road) -> Action:
        state.still_steps = state.crawl_steps = 0
        state.turn = math.copysign(1.0, road.angle + 0.1 * road.offset)
        return _action(brake=True, steer=state.turn)


#: Times of the state that run out.
_CLOCKS = (
    "hop_steps",
    "release_steps",
    "boost_steps",
    "big_boost_steps",
    "nitro_steps",
    "caution_steps",
    "reverse_steps",
    "rescue_steps",
)


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
