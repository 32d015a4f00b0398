"""Races as one batch, in which agents have a memory, and some see left and right swapped."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from gymnasium.vector import VectorWrapper

from stkzoo import RaceVectorEnv
from stkzoo.kernel import split_batch
from stkzoo.views import write_rows

from . import BoolArray, IntArray


class MemoryView(Protocol):
    """Observations and actions of all slots, with their memory."""

    def begin(self, rows: IntArray, is_mirrored: BoolArray) -> None:
        """Empties the memory of some slots, whose race begins.

        Args:
            rows: indices of the slots.
            is_mirrored: whether they observe and act with left and right swapped.
        """

    def observe(self, seen: Any, *, advances: bool = True) -> Any:
        """Returns observations of all slots.

        Args:
            seen: observations of the races.
            advances: whether a step has passed since the last call.
        """

    def drive(self, choices: npt.NDArray[Any]) -> Any:
        """Returns actions of the races for choices in the latest observations."""


class MirroredRaces(VectorWrapper):
    """Races in which agents observe and act through a view with a memory.

    Args:
        races: the races.
        view: the view of all slots.
        mirror_share: share of the slots, drawn for each race, that observe and act with left and
            right swapped.

    Attributes:
        races: the races.
        view: the view of all slots.
    """

    def __init__(self, races: RaceVectorEnv, view: MemoryView, mirror_share: float) -> None:
        super().__init__(races)
        self.races, self.view, self._mirror_share = races, view, mirror_share
        self._random = np.random.default_rng()

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Any = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts a new race in every environment; see :meth:`stkzoo.RaceVectorEnv.reset`."""
        seen, infos = self.races.reset(seed=seed, options=options)
        if seed is not None:
            numbers = seed if isinstance(seed, Sequence) else [seed]
            self._random = np.random.default_rng([n for n in numbers if n is not None] or None)
        self._begin(np.arange(self.num_envs))
        return self.view.observe(seen, advances=False), infos

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Starts a step of all races and returns before it is done."""
        self.races.step_async(self.view.drive(actions))

    def step(self, actions: npt.NDArray[Any]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Advances all races by one step."""
        self.step_async(actions)
        return self.step_wait()

    def step_wait(self) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Waits for the step and returns its result; see :meth:`stkzoo.RaceVectorEnv.step`."""
        seen, rewards, terminations, truncations, infos = self.races.step_wait()
        ended = terminations | truncations
        if not ended.any():
            return self.view.observe(seen), rewards, terminations, truncations, infos
        last, slots = copy.deepcopy(seen), np.flatnonzero(ended).tolist()
        for slot in slots:
            write_rows(last, np.array([slot]), infos["final_obs"][slot])
        observations = self.view.observe(last)
        rows = split_batch(observations, tuple(range(self.num_envs)))
        for slot in slots:
            infos["final_obs"][slot] = rows[slot]
        by_race = self.races.num_races, self.races.num_agents
        begins = ended.reshape(by_race).any(axis=1) & self.races.racing.reshape(by_race).all(axis=1)
        if begins.any():
            self._begin(np.flatnonzero(np.repeat(begins, by_race[1])))
            observations = self.view.observe(seen, advances=False)
        return observations, rewards, terminations, truncations, infos

    def _begin(self, slots: IntArray) -> None:
        self.view.begin(slots, self._random.random(len(slots)) < self._mirror_share)
