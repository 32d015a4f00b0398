"""Random shooting: try some changes of a policy in copies of the race, keep the best."""

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

#: What a step that is left after the finish line is worth [m].
_STEP_AFTER_FINISH = 3.0


@dataclass(frozen=True, slots=True)
class PlannerSettings:
    """How far, how often and how widely the planner looks.

    Attributes:
        horizon: steps that a plan reaches ahead.
        commitment: steps after which another plan is made.
        num_plans: plans that are tried each time; the first is to change nothing.
        num_parts: parts of equal length that a plan consists of.
        steer_spread: standard deviation of the changes of steering.
        drift_chance: how often a part of a plan forbids or forces a drift.
        speed_weight: what a speed of 1 m/s at a plan's end is worth [m].
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
    """Changes of what the base policy does.

    Attributes:
        steer: ``(H,)`` float64, added to its steering.
        drift: ``(H,)`` int64: 1 drifts, 0 does not, -1 leaves it to the base policy.
    """

    steer: npt.NDArray[np.float64]
    drift: npt.NDArray[np.int64]

    @classmethod
    def nothing(cls, settings: PlannerSettings) -> Plan:
        """The plan that changes nothing."""
        return cls(np.zeros(settings.horizon), np.full(settings.horizon, -1))

    @classmethod
    def draw(cls, settings: PlannerSettings, random: np.random.Generator) -> Plan:
        """A random plan, constant in each of its parts."""
        steer = random.normal(0.0, settings.steer_spread, settings.num_parts)
        drift = random.integers(0, 2, settings.num_parts)
        drift[random.random(settings.num_parts) >= settings.drift_chance] = -1
        part = np.arange(settings.horizon) * settings.num_parts // settings.horizon
        return cls(steer[part], drift[part])

    def rest(self, done: int) -> Plan:
        """What is left after some steps, and then nothing more."""
        steer = np.concatenate([self.steer[done:], np.zeros(done)])
        return Plan(steer, np.concatenate([self.drift[done:], np.full(done, -1)]))

    def change(self, action: Action, step: int) -> Action:
        """The base policy's action for a step of the plan, changed."""
        steer = np.clip(action["steer"] + self.steer[step], -1.0, 1.0).astype(np.float32)
        drift = action["drift"] if self.drift[step] < 0 else int(self.drift[step])
        return {**action, "steer": steer, "drift": drift}


@dataclass(slots=True)
class Planner:
    """Drives the one agent of an environment by looking ahead in copies of its race.

    It remembers its plan, so every race needs a new one.

    Args:
        settings: how far, how often and how widely it looks.
        base: the state of the heuristic driver that it improves on, at the start of a race.
        seed: of its random plans; the same seed drives the same race.
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
        """Picks the agent's action; the environment stays where it is.

        Args:
            env: an environment of one agent, in the ``full`` view.
            observation: what the agent sees now.

        Raises:
            ConfigError: the environment has several agents.
            EngineError: its races do not support saved states.
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
        """How far a plan leads [m], counting the speed at its end as distance too."""
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
