"""One race as slots, one per agent, which restart when all agents have ended; and steps of slots.

The results of a step are rows of arrays: observations, rewards, ends and infos of all slots.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo._checks import shortened
from stkzoo.env.episode import EndArrays, InfoTable
from stkzoo.env.parallel import RaceParallelEnv
from stkzoo.env.race import Race, Started
from stkzoo.env.vec.starts import AheadStarts
from stkzoo.errors import ConfigError, EngineCrashed, EngineError, EngineTimeout
from stkzoo.kernel import new_batch, split_batch
from stkzoo.views.plan import write_rows

logger = logging.getLogger(__name__)

#: Maximum number of attempts to start a race when the game crashes at the start.
_MAX_STARTS = 3

BoolArray = npt.NDArray[np.bool_]

#: Gymnasium's ``VectorEnv._add_info``, which adds the info of a slot to its form.
AddInfo = Callable[[dict[str, Any], dict[str, Any], int], dict[str, Any]]


class SlotSteps:
    """One step of ``S`` slots. At first, all slots are idle, and observations have no content.

    Args:
        form: form of the observations (:func:`~stkzoo.views.plan.form_of`).
        count: number of slots.

    Attributes:
        observations: next observation of each slot: after the end of a race, the first observation
            of the next one; for an idle slot, zeros. A batch (:mod:`stkzoo.views.plan`).
        infos: info of each slot, for the same moment as its observation; empty for idle slots.
        rewards: ``(S,)`` float64, 0 for idle slots.
        terminations: ``(S,)`` bool, whether the slot's agent finished in this step.
        truncations: ``(S,)`` bool, whether the slot's agent was truncated in this step.
        ends: rewards, terminations and truncations.
        active: ``(S,)`` bool, whether the slot's agent acted in this step.
        crashed: ``(S,)`` bool, whether the slot's game crashed in this step.
        tracks: ``(S,)`` number of each slot's track, for the same moment as its observation.
        finals: last observation and info of the slots that ended in this step, by slot.
    """

    def __init__(self, form: Any, count: int) -> None:
        self.observations: Any = new_batch(form, count)
        self.infos = SlotInfos(count)
        self.rewards = np.zeros(count)
        flags: BoolArray = np.zeros((4, count), np.bool_)
        self.terminations, self.truncations, self.active, self.crashed = flags
        self.ends: EndArrays = self.rewards, self.terminations, self.truncations
        self.tracks = np.zeros(count, np.int64)
        self.finals: dict[int, tuple[Any, dict[str, Any]]] = {}

    def show(self, slot: int, observation: Any, info: dict[str, Any]) -> None:
        """Writes an observation and an info for a slot.

        Raises:
            ConfigError: the observation, which a wrapper returned, is not in its space.
        """
        try:
            write_rows(self.observations, np.array([slot]), observation)
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            raise ConfigError(
                f"the observation of slot {slot} is {shortened(observation)}, which is not in its "
                "space; correct the wrapper that returned it"
            ) from error
        self.infos.set(slot, info)

    def complete(self, idle: npt.NDArray[np.intp], observation: Any) -> None:
        """Writes the observation of idle slots, which completes the observations."""
        if len(idle):
            write_rows(self.observations, idle, observation)
        self.observations = _with_tuples(self.observations)


class SlotInfos:
    """Infos of all slots.

    The kernel writes infos into tables: one, or several if races have different keys. The infos of
    races that have just started, and those from wrappers in Python, are dicts.

    Args:
        count: number of slots.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._tables: dict[tuple[str, ...], InfoTable] = {}
        self._dicts: dict[int, dict[str, Any]] = {}

    def table(self, keys: tuple[str, ...]) -> InfoTable:
        """Returns the table with some keys, in order."""
        if keys not in self._tables:
            self._tables[keys] = InfoTable(keys, self._count)
        return self._tables[keys]

    def set(self, slot: int, info: dict[str, Any]) -> None:
        """Sets the info of a slot."""
        self._dicts[slot] = info

    def columns(self, add: AddInfo) -> dict[str, npt.NDArray[Any]]:
        """Returns an array of values and a mask for each key, in Gymnasium's form.

        Args:
            add: adds the info of a slot to infos in this form.
        """
        columns: dict[str, npt.NDArray[Any]] = {}
        for table in self._tables.values():
            masks = np.tile(table.has, (len(table.columns), 1))
            for (key, values), mask in zip(table.columns.items(), masks, strict=True):
                if key in columns:  # other slots have it in another table, and 0 in this one
                    values, mask = values + columns[key], mask | columns[f"_{key}"]
                columns[key], columns[f"_{key}"] = values, mask
        for slot, info in sorted(self._dicts.items()):
            columns = add(columns, dict(info), slot)
        return columns

    def dicts(self) -> list[dict[str, Any]]:
        """Returns the info of each slot as a new dict of Python values; empty if it is idle."""
        infos: list[dict[str, Any]] = [{} for _ in range(self._count)]
        for table in self._tables.values():
            rows = split_batch(table.columns, tuple(range(self._count)))
            for slot in np.flatnonzero(table.has).tolist():
                infos[slot] = rows[slot]
        for slot, info in self._dicts.items():
            infos[slot] = dict(info)
        return infos


def _with_tuples(batch: Any) -> Any:
    """Returns a batch with tuples of texts, as Gymnasium stacks them."""
    if isinstance(batch, dict):
        return {key: _with_tuples(part) for key, part in batch.items()}
    return tuple(batch) if isinstance(batch, list) else batch


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
            with self.race.turn:
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


def shared_space(by_agent: Mapping[str, spaces.Space[Any]], purpose: str) -> spaces.Space[Any]:
    """Returns the space that all agents share, whose values stack into one array.

    Args:
        by_agent: each agent's space.
        purpose: ``"observation"`` or ``"action"``.

    Raises:
        ConfigError: the spaces differ, or their values differ in size.
    """
    first, *others = by_agent.values()
    if any(space != first for space in others):
        raise ConfigError(
            f"the agents differ in their {purpose} spaces; give all agents the same view, and "
            "use_ai to all of them or to none"
        )
    if not is_of_fixed_size(first):
        raise ConfigError(
            f"the {purpose} space is a {type(first).__name__} whose values differ in size; choose "
            'view="simple", one of the flattened views, or your own view with Box, Discrete, '
            "MultiDiscrete, MultiBinary, Text and Dict spaces"
        )
    return first


def is_of_fixed_size(space: spaces.Space[Any]) -> bool:
    """Whether all values of a space have the same size, so that they stack into one array."""
    if isinstance(space, spaces.Dict):
        return all(map(is_of_fixed_size, space.spaces.values()))
    kinds = spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary, spaces.Text
    return isinstance(space, kinds)
