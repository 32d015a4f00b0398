"""Races whose agents act through the action filter, as one batch."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import VectorWrapper

from stkzoo import RaceVectorEnv
from stkzoo.agents.planning import FloatArray
from stkzoo.agents.pretrained.action_filter import ActionFilter


class FilteredVectorEnv(VectorWrapper):
    """Races whose agents act through an :class:`ActionFilter` and observe its memory.

    Args:
        envs: races in the view ``racing`` or ``contest``. Observations get
            :data:`~stkzoo.agents.planning.memory.MEMORY_SIZE` more columns.
        hold: minimum steps of a drift.

    Attributes:
        races: the races.
        action_filter: the filter of all slots.
    """

    def __init__(self, envs: RaceVectorEnv, hold: int) -> None:
        super().__init__(envs)
        self.races = envs
        self.action_filter = ActionFilter(self.num_envs, hold)

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[FloatArray, dict[str, Any]]:
        """Starts new races; see :meth:`stkzoo.RaceVectorEnv.reset`."""
        views, infos = self.races.reset(seed=seed, options=options)
        self.action_filter.forget(slice(None))
        return self.action_filter.see(views), infos

    def step_async(self, choices: npt.NDArray[Any]) -> None:
        """Starts a step of all races with choices ``(num_envs, 5)``."""
        self.races.step_async(self.action_filter.apply(choices))

    def step_wait(self) -> tuple[FloatArray, Any, Any, Any, dict[str, Any]]:
        """Waits for the step and returns its result; see :meth:`stkzoo.RaceVectorEnv.step`."""
        views, rewards, terminations, truncations, infos = self.races.step_wait()
        ended = np.flatnonzero(terminations | truncations)
        last = np.array(views)
        for slot in ended.tolist():
            last[slot] = infos["final_obs"][slot]
        seen = self.action_filter.look(last)
        for slot in ended.tolist():
            infos["final_obs"][slot] = seen[slot]
        self.action_filter.forget(ended)
        return self.action_filter.see(views), rewards, terminations, truncations, infos
