"""Races whose agents act through the action filter, as one batch."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import VectorWrapper

from stkzoo import RaceVectorEnv
from stkzoo.agents.planning import FloatArray, IntArray
from stkzoo.agents.planning.view import begun_slots
from stkzoo.agents.pretrained.action_filter import ActionFilter
from stkzoo.wrappers.racing import CHOICES, CONTEST_MIRROR


class FilteredVectorEnv(VectorWrapper):
    """Races whose agents act through an :class:`ActionFilter` and observe its memory.

    Half of the slots, drawn for each race, observe and act with left and right swapped.

    Args:
        envs: races in the view ``contest``. Observations get
            :data:`~stkzoo.agents.planning.memory.MEMORY_SIZE` more columns.
        hold: minimum steps of a drift.

    Attributes:
        races: the races.
        action_filter: the filter of all slots.
    """

    def __init__(self, envs: RaceVectorEnv, hold: int) -> None:
        super().__init__(envs)
        self.races, self.action_filter = envs, ActionFilter(self.num_envs, hold)
        self._is_mirrored = np.zeros(self.num_envs, np.bool_)

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[FloatArray, dict[str, Any]]:
        """Starts new races; see :meth:`stkzoo.RaceVectorEnv.reset`."""
        views, infos = self.races.reset(seed=seed, options=options)
        self._random = np.random.default_rng(seed)
        self._begin(np.arange(self.num_envs))
        return self.action_filter.see(self._mirrored(views)), infos

    def step_async(self, choices: npt.NDArray[Any]) -> None:
        """Starts a step of all races with choices ``(num_envs, 5)``."""
        done = self.action_filter.apply(choices)
        done[self._is_mirrored, 0] = CHOICES[0] - 1 - done[self._is_mirrored, 0]
        self.races.step_async(done)

    def step_wait(self) -> tuple[FloatArray, Any, Any, Any, dict[str, Any]]:
        """Waits for the step and returns its result; see :meth:`stkzoo.RaceVectorEnv.step`."""
        views, rewards, terminations, truncations, infos = self.races.step_wait()
        ended = terminations | truncations
        slots = np.flatnonzero(ended).tolist()
        last = views.copy() if slots else views
        for slot in slots:
            last[slot] = infos["final_obs"][slot]
        seen = self.action_filter.look(self._mirrored(last))
        for slot in slots:
            infos["final_obs"][slot] = seen[slot]
        begun = begun_slots(self.races, ended)
        if len(begun):
            self._begin(begun)
            seen = self.action_filter.see(self._mirrored(views))
        return seen, rewards, terminations, truncations, infos

    def _begin(self, slots: IntArray) -> None:
        self.action_filter.forget(slots)
        self._is_mirrored[slots] = self._random.random(len(slots)) < 0.5

    def _mirrored(self, views: FloatArray) -> FloatArray:
        return np.where(self._is_mirrored[:, None], views * CONTEST_MIRROR, views)
