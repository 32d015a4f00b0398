"""Copies of a running race in which candidates are driven side by side."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any

from stkzoo import RaceParallelEnv
from stkzoo.agents.planning.driver import PlanDriver
from stkzoo.race.rescues import RescueCounter

from .candidates import Candidate, Choose, changed

Observation = Mapping[str, Any]


class RaceCopy:
    """A copy of a race, driven by a base policy with the changes of one candidate.

    Args:
        env: environment of the copy, which :meth:`begin` makes follow the race.
        agent: id of the agent that plans.
    """

    def __init__(self, env: RaceParallelEnv, agent: str) -> None:
        self._env, self._agent = env, agent

    def begin(
        self,
        env: RaceParallelEnv,
        driver: PlanDriver,
        observation: Observation,
        candidate: Candidate,
    ) -> None:
        """Continues from the current state of a race.

        Args:
            env: environment of the race.
            driver: state of the base policy, which is copied.
            observation: current observation of the agent.
            candidate: the candidate to drive.
        """
        self._env.follow(env)
        self.driver, self.candidate = copy.deepcopy(driver), candidate
        self.observation = observation
        self.steps, self.distance, self.finish_time = 0, 0.0, 0.0
        assert self._env.race is not None  # noqa: S101 - since follow
        self._race, index = self._env.race, self._env.possible_agents.index(self._agent)
        self._kart = self._race.kart_indices[index]
        assert self._env.snapshot is not None  # noqa: S101 - since follow
        self._begin = float(self._env.snapshot.header["time"])
        self._rescues = RescueCounter(self._env.options.num_kart)

    @property
    def is_over(self) -> bool:
        """Whether the kart has left the race."""
        return self._agent not in self._env.agents

    @property
    def length(self) -> float:
        """Length of the race [m]."""
        assert self._env.track_map is not None  # noqa: S101 - since follow
        return self._env.track_map.length * self._race.laps

    @property
    def seconds_to_finish(self) -> float | None:
        """Time from the beginning of the copy to the finish [s]; ``None`` before the finish."""
        return self.finish_time - self._begin if self.finish_time else None

    @property
    def num_rescues(self) -> int:
        """Number of rescues of the kart in this copy."""
        return int(self._rescues.counts[self._kart])

    @property
    def speed(self) -> float:
        """Forward speed of the kart [m/s]."""
        return float(self.observation["velocity"][2])

    @property
    def energy(self) -> float:
        """Remaining nitro [s]."""
        return float(self.observation["energy"][0])

    def request_step(self, action: Mapping[str, Any]) -> None:
        """Starts a step and returns while the game computes it."""
        self._env.step_async({self._agent: action})

    def finish_step(self) -> None:
        """Waits for the step."""
        observations, _, _, _, infos = self._env.step_wait()
        snapshot = self._env.snapshot
        assert snapshot is not None  # noqa: S101 - since a step
        self._rescues.update(snapshot.karts, float(snapshot.header["time"]))
        self.observation, info = observations[self._agent], infos[self._agent]
        self.distance, self.finish_time = float(info["distance"]), float(info["finish_time"])
        self.steps += 1

    def close(self) -> None:
        """Ends the process of the copy."""
        self._env.close()


def drive_copies(copies: Sequence[RaceCopy], choose: Choose | None, steps: int) -> None:
    """Drives several copies at the same time, each until its kart has left the race.

    One call of the policy decides for all copies, and their games compute each step in parallel.

    Args:
        copies: the copies. Those whose kart is still racing have taken the same number of steps.
        choose: the base policy.
        steps: number of steps.
    """
    for _ in range(steps):
        running = [race for race in copies if not race.is_over]
        if not running:
            return
        policy = changed(choose, [race.candidate for race in running], running[0].steps)
        actions = PlanDriver.drive_together(
            [race.driver for race in running], [race.observation for race in running], policy
        )
        for race, action in zip(running, actions, strict=True):
            race.request_step(action)
        for race in running:
            race.finish_step()
