"""One race as a row of slots, one per agent, which restarts when all agents have ended."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.env.vec.actions import ActionBatch
from stkzoo.env.vec.batch_race import BatchRace
from stkzoo.env.vec.steps import BoolArray, InfoDicts, SlotSteps
from stkzoo.errors import EngineCrashed, EngineError, EngineTimeout
from stkzoo.views.chains import CheckedActions

logger = logging.getLogger(__name__)

#: Maximum number of attempts to start a race when the game crashes at the start.
_MAX_STARTS = 3

Started = tuple[dict[str, Any], dict[str, dict[str, Any]]]


class RaceSlots(ABC):
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

    def __init__(self, race: BatchRace, number: int) -> None:
        self.race = race
        self.num_crashes = 0
        self.options: Mapping[str, Any] = {}
        self.track = ""
        self._number = number
        self._agents = race.possible_agents
        count = len(self._agents)
        self.slots = slice(number * count, (number + 1) * count)
        self._is_racing: BoolArray = np.zeros(count, np.bool_)
        self._returns = np.zeros(count)
        self._num_steps = 0
        self._failure: EngineError | None = None

    @property
    def racing(self) -> BoolArray:
        """``(A,)`` bool, whether each slot's agent is still racing."""
        return np.array(self._is_racing)

    @property
    def is_over(self) -> bool:
        """Whether all agents' episodes have ended, so that a :meth:`reset` is due."""
        return not self._is_racing.any()

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
        first = self._start(seed, options, _MAX_STARTS)
        self.track = race.track if (race := self.race.race) else ""
        self._is_racing[:] = [agent in first[0] for agent in self._agents]
        self._returns[:] = 0.0
        self._num_steps = 0
        self._failure = None
        self._show_first(steps, *first)

    @abstractmethod
    def check(self, actions: ActionBatch) -> CheckedActions:
        """Checks one action per slot and changes nothing; ignores actions of idle slots."""

    def send(self, controls: npt.NDArray[np.float32]) -> None:
        """Starts a step in the game; :meth:`step_wait` handles its crash."""
        try:
            self.race.send(controls)
        except (EngineCrashed, EngineTimeout) as error:
            self._failure = error

    def step_wait(self, steps: SlotSteps) -> None:
        """Waits for the step and writes its results into those of all slots."""
        steps.active[self.slots] = self._is_racing
        try:
            if self._failure is not None:
                raise self._failure
            self._advance(steps)
        except (EngineCrashed, EngineTimeout) as error:
            self._report(error, "its slots are truncated, and it is replaced")
            steps.crashed[self.slots] = True
            steps.truncations[self.slots] = self._is_racing
        self._num_steps += 1
        self._returns += steps.rewards[self.slots]
        ended = steps.terminations[self.slots] | steps.truncations[self.slots]
        if ended.any():
            self._end(steps, np.flatnonzero(ended).tolist())

    def close(self) -> None:
        """Closes the race's environment."""
        self._is_racing[:] = False
        self.race.close()

    @abstractmethod
    def _show_first(self, steps: SlotSteps, *first: Any) -> None:
        """Writes the first observations and infos of a race, which :meth:`reset` has started."""

    @abstractmethod
    def _advance(self, steps: SlotSteps) -> None:
        """Waits for the step and writes its results for the agents that acted.

        Observations and infos are those of the agents that are still racing.
        """

    @abstractmethod
    def _last(self, agents: Sequence[str]) -> list[tuple[Any, dict[str, Any]]]:
        """Returns the last observation and info of agents that ended in this step."""

    def _end(self, steps: SlotSteps, rows: list[int]) -> None:
        self._is_racing[rows] = False
        last = self._last([self._agents[row] for row in rows])
        has_crashed = bool(steps.crashed[self.slots.start])
        for row, (observation, info) in zip(rows, last, strict=True):
            if has_crashed:  # the infos are those of the step before
                info = {**info, **dict.fromkeys(filter(_is_of_a_step, info), 0.0)}
            episode = {"r": float(self._returns[row]), "l": self._num_steps}
            info = {**info, "episode": episode, "track": self.track}
            steps.finals[self.slots.start + row] = observation, info

    def _start(self, seed: int | None, options: Mapping[str, Any], attempts: int) -> Started:
        try:
            return self.race.reset(seed=seed, options=options)
        except (EngineCrashed, EngineTimeout) as error:
            if attempts == 1:
                raise
            self._report(error, "it restarts")
        return self._start(seed, options, attempts - 1)

    def _report(self, error: EngineError, consequence: str) -> None:
        self.num_crashes += 1
        logger.warning("race %d: %s (%s)", self._number, error.message, consequence)


class CompiledSlots(RaceSlots):
    """Slots whose rows in the arrays of all slots are read and written by the kernel."""

    def __init__(self, race: BatchRace, number: int) -> None:
        super().__init__(race, number)
        self._racing_slots = np.zeros(0, np.intp)

    def check(self, actions: ActionBatch) -> CheckedActions:
        """See :class:`RaceSlots`."""
        slots, count = self._racing_slots, actions.num_slots
        checked = self.race.check_batch(actions.batch, slots, count)
        return actions.check_singly(self.race, self.slots) if checked is None else checked

    def _show_first(self, steps: SlotSteps, *_: Any) -> None:
        self._find_slots()
        self.race.show_in(steps, self._racing_slots)

    def _advance(self, steps: SlotSteps) -> None:
        self.race.step_into(steps, self._racing_slots)
        if len(self.race.agents) < len(self._racing_slots):
            self._find_slots()
        if self.race.agents:
            self.race.show_in(steps, self._racing_slots)

    def _last(self, agents: Sequence[str]) -> list[tuple[Any, dict[str, Any]]]:
        observations, infos = self.race.observe(agents), self.race.infos(agents)
        return [(observations[agent], infos[agent]) for agent in agents]

    def _find_slots(self) -> None:
        """Finds the slot of each racing agent."""
        rows = [self._agents.index(agent) for agent in self.race.agents]
        self._racing_slots = np.array(rows, np.intp) + self.slots.start


class WalkedSlots(RaceSlots):
    """Slots of agents with wrappers in Python: their values are made one by one."""

    def __init__(self, race: BatchRace, number: int) -> None:
        super().__init__(race, number)
        self._latest: dict[str, tuple[Any, dict[str, Any]]] = {}  # observation and info by agent

    def check(self, actions: ActionBatch) -> CheckedActions:
        """See :class:`RaceSlots`."""
        return actions.check_singly(self.race, self.slots)

    def _show_first(self, steps: SlotSteps, *first: Any) -> None:
        observations, infos = first
        self._latest = {agent: (observations[agent], infos[agent]) for agent in observations}
        self._show(steps)

    def _advance(self, steps: SlotSteps) -> None:
        observations, rewards, terminations, truncations, infos = self.race.step_wait()
        for agent in observations:
            slot = self._slot(agent)
            steps.rewards[slot] = rewards[agent]
            steps.terminations[slot] = terminations[agent]
            steps.truncations[slot] = truncations[agent]
            self._latest[agent] = observations[agent], infos[agent]
        self._show(steps)

    def _show(self, steps: SlotSteps) -> None:
        """Writes the latest observations and infos of the racing agents."""
        for agent in self.race.agents:
            slot = self._slot(agent)
            steps.observations[slot], info = self._latest[agent]
            if isinstance(steps.infos, InfoDicts):
                steps.infos.set(slot, info)

    def _last(self, agents: Sequence[str]) -> list[tuple[Any, dict[str, Any]]]:
        return [self._latest.pop(agent) for agent in agents]

    def _slot(self, agent: str) -> int:
        return self.slots.start + self._agents.index(agent)


def _is_of_a_step(key: str) -> bool:
    """Returns whether a key of infos is about a single step: a reward's term or an event."""
    return key.startswith(("reward/", "event/"))
