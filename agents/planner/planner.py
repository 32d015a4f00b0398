"""Random shooting: tries changes of a policy's actions in copies of the race and keeps the best."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo import RaceParallelEnv
from stkzoo.agents.heuristic import create_state
from stkzoo.agents.planning.driver import PlanDriver
from stkzoo.errors import ConfigError

Action = dict[str, Any]

#: Worth of each remaining step after the finish line [m].
_STEP_AFTER_FINISH = 3.0


@dataclass(frozen=True, slots=True)
class PlannerSettings:
    """Settings of the search.

    Attributes:
        horizon: length of a plan in steps.
        commitment: steps after which a new plan is made.
        num_plans: number of plans to try; the first one changes nothing.
        num_parts: number of parts of equal length in a plan.
        steer_spread: standard deviation of the steering changes.
        drift_chance: probability that a part of a plan forbids or forces a drift.
        speed_weight: worth of a speed of 1 m/s at the end of a plan [m].
    """

    horizon: int = 24
    commitment: int = 8
    num_plans: int = 8
    num_parts: int = 3
    steer_spread: float = 0.4
    drift_chance: float = 0.3
    speed_weight: float = 0.8

    def __post_init__(self) -> None:
        if not 1 <= self.commitment <= self.horizon:
            raise ConfigError(
                f"commitment is {self.commitment}, expected 1 to the horizon, {self.horizon}"
            )


@dataclass(frozen=True, slots=True)
class Plan:
    """Changes of the base policy's actions.

    Attributes:
        steer: ``(H,)`` float64, added to its steering.
        drift: ``(H,)`` int64: 1 drifts, 0 does not, -1 keeps the base policy's choice.
    """

    steer: npt.NDArray[np.float64]
    drift: npt.NDArray[np.int64]

    @classmethod
    def nothing(cls, settings: PlannerSettings) -> Plan:
        """Returns the plan without changes."""
        return cls(np.zeros(settings.horizon), np.full(settings.horizon, -1))

    @classmethod
    def draw(cls, settings: PlannerSettings, random: np.random.Generator) -> Plan:
        """Draws a random plan that is constant in each of its parts."""
        steer = random.normal(0.0, settings.steer_spread, settings.num_parts)
        drift = random.integers(0, 2, settings.num_parts)
        drift[random.random(settings.num_parts) >= settings.drift_chance] = -1
        part = np.arange(settings.horizon) * settings.num_parts // settings.horizon
        return cls(steer[part], drift[part])

    def rest(self, done: int) -> Plan:
        """Returns the remaining plan after some steps, padded with no change."""
        steer = np.concatenate([self.steer[done:], np.zeros(done)])
        return Plan(steer, np.concatenate([self.drift[done:], np.full(done, -1)]))

    def change(self, action: Action, step: int) -> Action:
        """Returns the base policy's action with the changes of a step."""
        steer = np.clip(action["steer"] + self.steer[step], -1.0, 1.0).astype(np.float32)
        drift = action["drift"] if self.drift[step] < 0 else int(self.drift[step])
        return {**action, "steer": steer, "drift": drift}


@dataclass(slots=True)
class Planner:
    """Drives the only agent of an environment by searching in copies of its race.

    It keeps its current plan, so use a new planner for every race.

    Args:
        settings: settings of the search.
        base: initial state of the heuristic driver, which is the base policy.
        seed: seed of its random plans; the same seed drives the same race.
    """

    settings: PlannerSettings = field(default_factory=PlannerSettings)
    base: PlanDriver = field(default_factory=create_state)
    seed: int = 0
    _random: np.random.Generator = field(init=False)
    _plan: Plan = field(init=False)
    _step: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        self._plan = Plan.nothing(self.settings)

    def act(self, env: RaceParallelEnv, observation: Mapping[str, Any]) -> Action:
        """Returns the agent's action; the environment does not advance.

        Args:
            env: an environment with one agent in the ``full`` view.
            observation: current observation of the agent.

        Raises:
            ConfigError: the environment has several agents.
            EngineError: the environment does not support saved states.
        """
        if len(env.possible_agents) != 1:
            raise ConfigError(
                f"the environment has {len(env.possible_agents)} agents, expected agents=1"
            )
        if self._step % self.settings.commitment == 0:
            self._plan = self._best_plan(env, observation)
            self._step = 0
        action = self._plan.change(self.base.drive(observation), self._step)
        self._step += 1
        return action

    def _best_plan(self, env: RaceParallelEnv, observation: Mapping[str, Any]) -> Plan:
        plans = [Plan.nothing(self.settings), self._plan.rest(self._step)]
        while len(plans) < self.settings.num_plans:
            plans.append(Plan.draw(self.settings, self._random))
        with env.save_state() as state, env.lookahead() as branch:
            values = []
            for plan in plans[: self.settings.num_plans]:
                branch.restore_state(state)
                values.append(self._value(branch, observation, plan))
        return plans[int(np.argmax(values))]

    def _value(self, branch: RaceParallelEnv, observation: Mapping[str, Any], plan: Plan) -> float:
        """Returns the distance that a plan reaches [m], with a bonus for the final speed."""
        (agent,) = branch.possible_agents
        base = copy.deepcopy(self.base)
        distance = speed = 0.0
        for step in range(self.settings.horizon):
            action = plan.change(base.drive(observation), step)
            observations, _, terminations, truncations, infos = branch.step({agent: action})
            observation = observations[agent]
            distance = float(infos[agent]["distance"])
            speed = float(observation["velocity"][2])
            if terminations[agent]:
                return distance + _STEP_AFTER_FINISH * (self.settings.horizon - step)
            if truncations[agent]:
                break
        return distance + self.settings.speed_weight * speed
