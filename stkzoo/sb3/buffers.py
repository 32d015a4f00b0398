"""Rollout buffers for races, in which some slots are idle."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from stable_baselines3.common.buffers import DictRolloutBuffer, RolloutBuffer

from stkzoo.errors import ConfigError


class ActiveRolloutBuffer(RolloutBuffer):
    """A rollout buffer that leaves out the steps of idle slots.

    Pass it as ``rollout_buffer_class`` to PPO or A2C with a :class:`~stkzoo.sb3.RaceVecEnv`. It
    recognizes an idle step as an episode of length one, so it also works with wrapped environments.
    The step of a race that ends in its first step is left out, too. Batches have the usual size;
    there are fewer of them.

    Attributes:
        active: indices of the real steps in the flattened buffer, slot by slot. Set by
            :meth:`compute_returns_and_advantage`.
    """

    def compute_returns_and_advantage(
        self, last_values: torch.Tensor, dones: npt.NDArray[Any]
    ) -> None:
        """Computes returns and advantages, and determines which steps are real.

        Args:
            last_values: value estimates of the last observations, ``(num_envs,)``.
            dones: ``(num_envs,)`` whether the last step ended each slot's episode.

        Raises:
            ConfigError: no episode has more than one step.
        """
        super().compute_returns_and_advantage(last_values, dones)
        starts = self.episode_starts.astype(np.bool_)
        ends = np.vstack([starts[1:], dones.astype(np.bool_)[None]])
        self.active = np.flatnonzero(~(starts & ends).T)  # slot after slot, as steps lie flat
        if not len(self.active):
            raise ConfigError(
                "all episodes of the rollout have one step, and this buffer leaves such steps out; "
                "raise max_cycles, or leave out rollout_buffer_class"
            )

    def get(self, batch_size: int | None = None) -> Generator[Any, None, None]:
        """Yields the real steps in random order, in batches of ``batch_size``."""
        next(super().get(1))  # lays the steps flat
        order = np.random.permutation(self.active)
        size = batch_size or max(len(order), 1)
        for first in range(0, len(order), size):
            yield self._get_samples(order[first : first + size])


class ActiveDictRolloutBuffer(ActiveRolloutBuffer, DictRolloutBuffer):
    """:class:`ActiveRolloutBuffer` for dictionary observations."""
