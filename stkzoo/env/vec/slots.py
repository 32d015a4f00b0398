"""One race as a row of slots, one per agent, which restarts when all agents have ended."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.env.vec.ahead import AheadRace
from stkzoo.errors import EngineCrashed, EngineError, EngineTimeout

logger = logging.getLogger(__name__)

#: Maximum number of attempts to start a race when the game crashes at the start.
_MAX_STARTS = 3

BoolArray = npt.NDArray[np.bool_]


@dataclass(slots=True)
class SlotSteps:
    """One step of ``S`` slots.

    Attributes:
        observations: next observation of each slot: after the end of a race, the first observation
            of the next one; for an idle slot, zeros.
        rewards: ``(S,)`` float64, 0 for idle slots.
        terminations: ``(S,)`` bool, whether the slot's agent finished in this step.
        truncations: ``(S,)`` bool, whether the slot's agent was truncated in this step.
        active: ``(S,)`` bool, whether the slot's agent acted in this step.
        infos: info of each slot, for the same moment as its observation; empty for idle slots.
        finals: last observation and info of the slots that ended in this step, by slot.
        crashed: ``(S,)`` bool, whether the slot's game crashed in this step.
        tracks: track of each slot, for the same moment as its observation.
    """

    observations: list[Any]
    rewards: npt.NDArray[np.float64]
    terminations: BoolArray
    truncations: BoolArray
    active: BoolArray
    infos: list[dict[str, Any]]
    finals: dict[int, tuple[Any, dict[str, Any]]]
    crashed: BoolArray
    tracks: list[str]

    @classmethod
    def idle(cls, idle_obs: Any, count: int) -> SlotSteps:
        """Returns a step in which all slots are idle."""
        flags = ("terminations", "truncations", "active", "crashed")
        return cls(
            observations=[idle_obs] * count,
            rewards=np.zeros(count),
            infos=[{} for _ in range(count)],
            finals={},
            tracks=[""] * count,
            **{name: np.zeros(count, np.bool_) for name in flags},
        )


class RaceSlots:
    """The slots of one race.

    Args:
        race: environment of the race.
        number: number of the race.

    Attributes:
        race: environment of the race.
        slots: range of this race's slots among those of all races.
        num_crashes: number of times the game crashed or hung.
        options: options for every race that starts from now on.
        track: track of the current race.
    """

    def __init__(self, race: AheadRace, number: int) -> None:
        self.race = race
        self.num_crashes = 0
        self.options: Mapping[str, Any] = {}
        self.track = ""
        self._number = number
        self._agents = race.possible_agents
        count = len(self._agents)
        self.slots = slice(number * count, (number + 1) * count)
        self._last: dict[str, tuple[Any, dict[str, Any]]] = {}  # by agent, observation and info
        self._returns = np.zeros(count)
        self._num_steps = 0
        self._failure: EngineError | None = None

    @property
    def racing(self) -> BoolArray:
        """``(S,)`` bool, whether each slot's agent is still racing."""
        racing = self.race.agents
        return np.array([agent in racing for agent in self._agents], np.bool_)

    @property
    def is_over(self) -> bool:
        """Whether all agents' episodes have ended, so that a :meth:`reset` is due."""
        return not self._last

    def prepare(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Starts the race for the next :meth:`reset` with the same arguments ahead of time."""
        self.race.prepare(seed, {**self.options, **(options or {})})

    def reset(
        self,
        steps: SlotSteps,
        seed: int | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Starts a new race.

        Args:
            steps: steps of all slots; receives the first observations and infos.
            seed: see :meth:`~stkzoo.env.parallel.RaceParallelEnv.reset`.
            options: options of this race only; they take precedence over :attr:`options`.

        Raises:
            EngineError: the game crashed several times in a row.
        """
        options = {**self.options, **(options or {})}
        observations, infos = self._start(seed, options, _MAX_STARTS)
        self.track = race.track if (race := self.race.race) else ""
        self._last = {agent: (observations[agent], infos[agent]) for agent in observations}
        self._returns[:] = 0.0
        self._num_steps = 0
        self._failure = None
        for slot, agent in enumerate(self._agents, self.slots.start):
            if agent in observations:
                steps.observations[slot], steps.infos[slot] = self._last[agent]

    def decode(self, actions: Sequence[Any]) -> npt.NDArray[np.float32]:
        """Checks one action per slot and returns the controls; ignores actions of idle slots."""
        return self.race.decode(dict(zip(self._agents, actions, strict=True)))

    def send(self, controls: npt.NDArray[np.float32]) -> None:
        """Starts a step in the game; :meth:`step_wait` handles its crash."""
        try:
            self.race.send(controls)
        except (EngineCrashed, EngineTimeout) as error:
            self._failure = error

    def step_wait(self, steps: SlotSteps) -> None:
        """Waits for the step and writes its results into those of all slots."""
        steps.active[self.slots] = self.racing
        try:
            if self._failure is not None:
                raise self._failure
            result = self.race.step_wait()
        except (EngineCrashed, EngineTimeout) as error:
            self._report(error, "its slots are cut short and it is replaced")
            self._num_steps += 1
            self._cut_short(steps)
        else:
            self._num_steps += 1
            self._take_in(steps, *result)

    def close(self) -> None:
        """Closes the race's environment."""
        self._last = {}
        self.race.close()

    def _start(
        self, seed: int | None, options: Mapping[str, Any], attempts: int
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        try:
            return self.race.reset(seed=seed, options=options)
        except (EngineCrashed, EngineTimeout) as error:
            if attempts == 1:
                raise
            self._report(error, "it is started again")
        return self._start(seed, options, attempts - 1)

    def _report(self, error: EngineError, consequence: str) -> None:
        self.num_crashes += 1
        logger.warning("race %d: %s (%s)", self._number, error.message, consequence)

    def _take_in(
        self,
        steps: SlotSteps,
        observations: Mapping[str, Any],
        rewards: Mapping[str, float],
        terminations: Mapping[str, bool],
        truncations: Mapping[str, bool],
        infos: Mapping[str, dict[str, Any]],
    ) -> None:
        for row, agent in enumerate(self._agents):
            if agent not in observations:
                continue
            slot = self.slots.start + row
            steps.rewards[slot] = rewards[agent]
            self._returns[row] += rewards[agent]
            steps.terminations[slot] = terminations[agent]
            steps.truncations[slot] = truncations[agent]
            self._last[agent] = observations[agent], infos[agent]
            if terminations[agent] or truncations[agent]:
                steps.finals[slot] = self._final(row)
            else:
                steps.observations[slot], steps.infos[slot] = self._last[agent]

    def _cut_short(self, steps: SlotSteps) -> None:
        """Truncates the agents of a crashed race at their last observation."""
        steps.crashed[self.slots] = True
        steps.truncations[self.slots] = steps.active[self.slots]
        for row in np.flatnonzero(steps.active[self.slots]).tolist():
            steps.finals[self.slots.start + row] = self._final(row)

    def _final(self, row: int) -> tuple[Any, dict[str, Any]]:
        """Returns the last observation and info of a slot whose episode ends in this step."""
        observation, info = self._last.pop(self._agents[row])
        episode = {"r": float(self._returns[row]), "l": self._num_steps}
        return observation, {**info, "episode": episode, "track": self.track}
