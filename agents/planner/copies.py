"""Candidates of the search, and copies of a running race in which they are driven.

A candidate is a change of a base policy's choices for some steps.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stkzoo import RaceParallelEnv
from stkzoo.agents.planning import FloatArray, IntArray
from stkzoo.agents.planning.driver import HEADS, OFFSETS, PlanDriver, PolicyInput, likeliest
from stkzoo.agents.planning.worth import LEAST_LOGIT
from stkzoo.race.rescues import RescueCounter

Observation = Mapping[str, Any]
#: Returns a policy's choices ``(A, 4)``; ``None`` takes the prior's most likely ones.
Choose = Callable[[PolicyInput], IntArray]

#: A maneuver without a plan at the moment has at most this logit in the prior.
_NO_PLAN = LEAST_LOGIT + 1
_BEGIN, _TURN, _NITRO = range(3)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A change of the base policy's choices that holds for several steps.

    Attributes:
        shift: added to the index of the chosen offset in
            :data:`stkzoo.agents.planning.driver.OFFSETS`.
        steps: number of steps for which the change holds.
        maneuver: maneuver instead of the chosen one; ``None`` keeps the chosen one.
        flips_nitro: whether nitro is used if the base policy does not use it, and the reverse.
    """

    shift: int = 0
    steps: int = 0
    maneuver: int | None = None
    flips_nitro: bool = False

    def rest(self, done: int) -> Candidate:
        """Returns what remains of the candidate after some steps."""
        return replace(self, steps=max(self.steps - done, 0))

    def change(self, choices: IntArray, begin: FloatArray, step: int) -> None:
        """Changes the choices of one kart in a step.

        Args:
            choices: ``(4,)`` choices of the base policy, which change.
            begin: ``(4,)`` the prior's logits of the maneuvers.
            step: number of steps since the candidate began.
        """
        if step >= self.steps:
            return
        if self.maneuver is not None and begin[self.maneuver] > _NO_PLAN:
            choices[_BEGIN] = self.maneuver
        choices[_NITRO] ^= self.flips_nitro
        choices[_TURN] = np.clip(choices[_TURN] + self.shift, 0, len(OFFSETS) - 1)


def changed(choose: Choose | None, candidates: Sequence[Candidate], step: int) -> Choose:
    """Returns the base policy with the change of one candidate for each kart.

    Args:
        choose: the base policy.
        candidates: one candidate for each row of the policy's input.
        step: number of steps since the candidates began.
    """

    def choose_changed(view: PolicyInput) -> IntArray:
        chosen = likeliest(view.prior) if choose is None else choose(view)
        for candidate, row, prior in zip(candidates, chosen, view.prior, strict=True):
            candidate.change(row, prior[HEADS[_BEGIN]], step)
        return chosen

    return choose_changed


class RaceCopy:
    """A copy of a race, driven by a base policy with the changes of one candidate.

    Args:
        env: environment of the copy, which :meth:`begin` makes follow the race.
        agent: id of the agent that plans.

    Attributes:
        driver: state of the base policy.
        candidate: the candidate that is driven.
        observation: current observation of the agent.
        steps: number of steps since the copy began.
        distance: distance that the kart has driven in the race [m].
        length: length of the race [m].
        seconds_to_finish: time from the beginning of the copy to the finish [s]; ``None`` before
            the finish.
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
        self.observation, self.steps, self.distance = observation, 0, 0.0
        race, track, snapshot = self._env.race, self._env.track_map, self._env.snapshot
        assert race is not None  # noqa: S101 - since follow
        assert track is not None  # noqa: S101 - since follow
        assert snapshot is not None  # noqa: S101 - since follow
        self.length = track.length * race.laps
        self.seconds_to_finish: float | None = None
        self._begin = float(snapshot.header["time"])
        self._kart = race.kart_indices[self._env.possible_agents.index(self._agent)]
        self._rescues = RescueCounter(self._env.options.num_kart)

    @property
    def is_over(self) -> bool:
        """Whether the kart has left the race."""
        return self._agent not in self._env.agents

    @property
    def num_rescues(self) -> int:
        """Number of rescues of the kart in this copy."""
        return int(self._rescues.counts[self._kart])

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
        self.distance = float(info["distance"])
        if info["finish_time"]:
            self.seconds_to_finish = float(info["finish_time"]) - self._begin
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
