"""One race as a row of slots, one per agent, which restarts when all agents have ended."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.env.parallel import RaceParallelEnv
from stkzoo.env.race import Race, Started
from stkzoo.env.vec.rows import SlotSteps
from stkzoo.env.vec.starts import AheadStarts
from stkzoo.errors import EngineCrashed, EngineError, EngineTimeout

logger = logging.getLogger(__name__)

#: Maximum number of attempts to start a race when the game crashes at the start.
_MAX_STARTS = 3


class RaceSlots:
    """The slots of one race.

    Args:
        env: environment of the race.
        number: number of the race.

    Attributes:
        env: environment of the race.
        slots: range of this race's slots among those of all races.
        racing_slots: slots of the agents that are still racing.
        num_crashes: number of times the game crashed or hung.
        options: options for every race that starts from now on.
        track: track of the current race.
    """

    def __init__(self, env: RaceParallelEnv, number: int) -> None:
        self.env, self._number = env, number
        self.num_crashes = 0
        self.options: Mapping[str, Any] = {}
        self.track = ""
        count = len(env.possible_agents)
        self.slots = slice(number * count, (number + 1) * count)
        self.racing_slots = np.zeros(0, np.intp)
        self._slot_of = {agent: self.slots.start + n for n, agent in enumerate(env.possible_agents)}
        self._returns = np.zeros(count)
        self._num_steps = 0
        self._failure: EngineError | None = None
        self._latest: Started = {}, {}  # of agents with wrappers in Python

    @property
    def race(self) -> Race:
        """The race."""
        return self.env.live_race

    @property
    def is_over(self) -> bool:
        """Whether all agents' episodes have ended, so that a :meth:`reset` is due."""
        return not len(self.racing_slots)

    def prepare(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Starts the race for the next :meth:`reset` with the same arguments ahead of time.

        The results of ``reset`` do not depend on this call. If it fails, ``reset`` starts the race
        itself and reports the error if that fails too. With starts to copy, or options with a state
        or a scenario, it does nothing.
        """
        starts = self.race.starts
        if isinstance(starts, AheadStarts):
            setup = self.race.next_setup(seed, {**self.options, **(options or {})})
            if setup is not None:
                starts.prepare(setup)

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
        self._latest = self._start(seed, options, _MAX_STARTS)
        self.track = race.track if (race := self.env.race) else ""
        self.racing_slots = np.array([self._slot_of[agent] for agent in self.env.agents], np.intp)
        self._returns[:] = 0.0
        self._num_steps = 0
        self._failure = None
        self._show(steps)

    def send(self, controls: npt.NDArray[np.float32]) -> None:
        """Starts a step in the game; :meth:`step_wait` handles its crash."""
        try:
            self.race.send(controls)
        except (EngineCrashed, EngineTimeout) as error:
            self._failure = error

    def step_wait(self, steps: SlotSteps) -> None:
        """Waits for the step and writes its results into those of all slots."""
        steps.active[self.racing_slots] = True
        left = self.racing_slots
        try:
            if self._failure is not None:
                raise self._failure
            with self.race.turn.of("step_wait"):
                left = self._advance(steps)
        except (EngineCrashed, EngineTimeout) as error:
            self._report(error, "its slots are truncated, and it is replaced")
            steps.crashed[self.slots] = True
            steps.truncations[self.racing_slots] = True
            left = left[:0]
        self._num_steps += 1
        self._returns += steps.rewards[self.slots]
        if len(left) < len(self.racing_slots):
            self._end(steps, np.setdiff1d(self.racing_slots, left))
            self.racing_slots = left

    def close(self) -> None:
        """Closes the race's environment."""
        self.racing_slots = self.racing_slots[:0]
        self.env.close()

    def _advance(self, steps: SlotSteps) -> npt.NDArray[np.intp]:
        """Waits for the step, writes its results and returns the slots that are still racing."""
        if self.race.chains.has_rows:
            return self.race.finish_into(steps, self.racing_slots)
        observations, rewards, terminations, truncations, infos = self.race.finish()
        self._latest = observations, infos
        slots = self.racing_slots
        steps.rewards[slots] = list(rewards.values())
        steps.terminations[slots] = list(terminations.values())
        steps.truncations[slots] = list(truncations.values())
        self._show(steps)
        return np.array([self._slot_of[agent] for agent in self.race.agents], np.intp)

    def _show(self, steps: SlotSteps) -> None:
        """Writes the latest observations and infos of the racing agents."""
        observations, infos = self._latest
        for agent in self.race.agents:
            steps.show(self._slot_of[agent], observations[agent], infos[agent])

    def _end(self, steps: SlotSteps, ended: npt.NDArray[np.intp]) -> None:
        """Adds the last observations and infos of slots whose agents have ended."""
        agents = [self.env.possible_agents[slot - self.slots.start] for slot in ended]
        observations, infos = self._latest
        if self.race.chains.has_rows:
            observations, infos = self.race.observe(agents), self.race.infos(agents)
        has_crashed = bool(steps.crashed[self.slots.start])
        for slot, agent in zip(ended.tolist(), agents, strict=True):
            row, info = slot - self.slots.start, infos[agent]
            if has_crashed:  # the infos are those of the step before
                info = {**info, **dict.fromkeys(filter(_is_of_a_step, info), 0.0)}
            episode = {"r": float(self._returns[row]), "l": self._num_steps}
            info = {**info, "episode": episode, "track": self.track}
            steps.finals[slot] = observations[agent], info

    def _start(self, seed: int | None, options: Mapping[str, Any], attempts: int) -> Started:
        try:
            return self.env.reset(seed=seed, options=options)
        except (EngineCrashed, EngineTimeout) as error:
            if attempts == 1:
                raise
            self._report(error, "it restarts")
        return self._start(seed, options, attempts - 1)

    def _report(self, error: EngineError, consequence: str) -> None:
        self.num_crashes += 1
        logger.warning("race %d: %s (%s)", self._number, error.message, consequence)


def _is_of_a_step(key: str) -> bool:
    """Returns whether a key of infos is about a single step: a reward's term or an event."""
    return key.startswith(("reward/", "event/"))
