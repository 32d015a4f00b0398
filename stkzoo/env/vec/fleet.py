"""Races side by side: all are asked before the first is waited for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector.utils import concatenate, create_empty_array
from gymnasium.wrappers.utils import create_zero_array

from stkzoo._os import cpu_count
from stkzoo.env.vec.ahead import AheadRace
from stkzoo.env.vec.slots import RaceSlots, SlotSteps
from stkzoo.errors import ActionError, ApiOrderError, ConfigError, check_whole
from stkzoo.views.actions import read_actions


class ParallelRaces:
    """Races with equal options, whose agents are slots in race-major order.

    What :class:`~stkzoo.env.vec.env.RaceVectorEnv` and the Stable-Baselines3 form have in
    common.

    Args:
        num_races: how many races.
        prefetch: start each race's successor while it runs; ``None`` does so if there are
            more processor cores than races.
        options: options of :class:`~stkzoo.env.parallel.RaceParallelEnv`.

    Attributes:
        races: every race's environment.
        agents: the agents of each race.
        prefetch: whether races are started ahead.
        single_observation_space: one slot's observation space.
        single_action_space: one slot's action space.
        idle_observation: what slots see whose episode has ended before their race: zeros, or
            what comes nearest to them in the space.

    Raises:
        ConfigError: an option is invalid, or agents differ in what they see or do.
    """

    def __init__(self, num_races: int, prefetch: bool | None, options: Mapping[str, Any]) -> None:
        check_whole("num_races", num_races, 1)
        if not isinstance(prefetch, (bool, type(None))):
            raise ConfigError(f"prefetch is {prefetch!r}, expected True, False or None")
        self.prefetch = cpu_count() > num_races if prefetch is None else prefetch
        self.races = tuple(AheadRace(**options) for _ in range(num_races))
        self.agents = tuple(self.races[0].possible_agents)
        self.single_observation_space = _shared(self.races[0].observation_spaces, "observation")
        self.single_action_space = _shared(self.races[0].action_spaces, "action")
        self.idle_observation = create_zero_array(self.single_observation_space)
        self._rows = [
            RaceSlots(race, number, self.idle_observation) for number, race in enumerate(self.races)
        ]
        self._names = [f"{agent} of race {n}" for n in range(num_races) for agent in self.agents]
        self._is_player = np.array([not spec.use_ai for spec in self.races[0].specs] * num_races)
        self._is_asked = False
        self._is_closed = False

    @property
    def num_slots(self) -> int:
        """Races times agents."""
        return len(self._names)

    @property
    def num_crashes(self) -> int:
        """How often the game died or hung, in all races together."""
        return sum(row.num_crashes for row in self._rows)

    @property
    def racing(self) -> npt.NDArray[np.bool_]:
        """``(num_slots,)`` bool: whose agent is in its race now."""
        return np.concatenate([row.racing for row in self._rows])

    def reset(
        self,
        seeds: Sequence[int | None],
        options: Sequence[Mapping[str, Any] | None],
    ) -> tuple[list[Any], list[dict[str, Any]]]:
        """New races everywhere.

        Args:
            seeds: each race's seed; ``None`` goes on with its random stream.
            options: each race's options for this episode alone.

        Returns:
            Every slot's observation and info.
        """
        self._require_open("reset")
        self._is_asked = False
        for row, seed, changes in zip(self._rows, seeds, options, strict=True):
            row.prepare(seed, changes)
        results = [
            row.reset(seed, changes)
            for row, seed, changes in zip(self._rows, seeds, options, strict=True)
        ]
        self._prefetch(self._rows)
        return (
            [obs for observations, _ in results for obs in observations],
            [info for _, infos in results for info in infos],
        )

    def step_async(self, actions: Sequence[Any]) -> None:
        """Asks all races for a step.

        Args:
            actions: one for each slot; those of idle slots are not looked at.

        Raises:
            ActionError: an action is invalid; no race has moved.
            ApiOrderError: before ``reset``, after ``close``, or twice in a row.
        """
        self._require_open("step")
        if self._is_asked:
            raise ApiOrderError("step_async() twice without step_wait(); call step_wait() first")
        if any(row.is_over for row in self._rows):
            raise ApiOrderError("step() before reset(); call reset() first")
        if len(actions) != self.num_slots:
            raise ActionError(
                f"{len(actions)} actions came for {self.num_slots} slots ({len(self.races)} races "
                f"of {len(self.agents)} agents); send one for each, idle ones too",
                self._names[0],
            )
        width = len(self.agents)
        try:
            controls = [
                row.decode(actions[number * width : (number + 1) * width])
                for number, row in enumerate(self._rows)
            ]
        except ActionError:
            self._name_the_race(actions)
            raise
        self._is_asked = True
        for row, own in zip(self._rows, controls, strict=True):
            row.send(own)

    def step_wait(self) -> SlotSteps:
        """The step that was asked for; races that are over have started again.

        Raises:
            AgentException: a wrapper failed; ``reset`` starts a new race.
            ApiOrderError: no step was asked for.
        """
        if not self._is_asked:
            raise ApiOrderError("step_wait() without step_async(); call step_async() first")
        self._is_asked = False
        parts = [self._collect(row) for row in self._rows]
        over = [number for number, row in enumerate(self._rows) if row.is_over]
        for number in over:
            parts[number].observations, parts[number].infos = self._rows[number].reset()
        self._prefetch([self._rows[number] for number in over])
        return SlotSteps.joined(parts)

    def batch(self, observations: Sequence[Any]) -> Any:
        """Every slot's observation as one array, or dict of arrays, that nobody else holds."""
        space = self.single_observation_space
        empty: Any = create_empty_array(space, len(observations))
        return concatenate(space, observations, empty)

    def close(self) -> None:
        """Ends all races."""
        self._is_closed = True
        for row in self._rows:
            row.close()

    def _collect(self, row: RaceSlots) -> SlotSteps:
        steps = row.step_wait()
        if row.is_over:  # the next one starts while the others are waited for
            row.prepare()
        return steps

    def _name_the_race(self, actions: Sequence[Any]) -> None:
        """Raises the error of an action that cannot be with its agent's race in it."""
        racing = np.flatnonzero(self.racing & self._is_player).tolist()
        names = [self._names[slot] for slot in racing]
        read_actions(self.single_action_space, [actions[slot] for slot in racing], names)

    def _prefetch(self, rows: Sequence[RaceSlots]) -> None:
        if self.prefetch:
            for row in rows:
                row.prepare()

    def _require_open(self, method: str) -> None:
        if self._is_closed:
            raise ApiOrderError(f"{method}() after close(); make a new environment")


def _shared(by_agent: Mapping[str, spaces.Space[Any]], kind: str) -> spaces.Space[Any]:
    """The one space of all agents, of a kind that can be one array."""
    first, *others = by_agent.values()
    if any(space != first for space in others):
        raise ConfigError(
            f"the agents differ in their {kind} spaces: {dict(by_agent)}; slots of one batch "
            "need one view for all agents, and none or all of them driven by the game's AI"
        )
    if not _is_of_fixed_size(first):
        raise ConfigError(
            f"the {kind} space is {first}, whose values differ in size, so that those of many "
            'slots are no array; choose view="simple", one of the flattened views, or a view of '
            "yours with Box, Discrete, MultiDiscrete, MultiBinary, Text and Dict spaces"
        )
    return first


def _is_of_fixed_size(space: spaces.Space[Any]) -> bool:
    if isinstance(space, spaces.Dict):
        return all(map(_is_of_fixed_size, space.spaces.values()))
    kinds = spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary, spaces.Text
    return isinstance(space, kinds)
