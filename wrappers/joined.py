"""Numbers and choices as one vector, for learners that take nothing else."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from stkzoo.errors import ConfigError
from stkzoo.views.bases import CompiledWrapper

if TYPE_CHECKING:
    from stkzoo.views.plan import ViewPlan

__all__ = ["JoinedObservations"]


class JoinedObservations(gym.ObservationWrapper[Any, Any, Any], CompiledWrapper):
    """Joins the ``continuous`` and ``discrete`` vectors of a flattened view into one.

    The observation becomes ``(n + v,)`` float32: the ``n`` numbers as they are, then one place
    for each of the ``v`` values of all choices, 1 for the value that holds and 0 for the others.
    If the view has further entries (``action_mask``, or ``action`` of the game's AI), it stays a
    dict, with the vector under ``observation`` beside them.

    Args:
        env: an environment in a flattened view.

    Raises:
        ConfigError: the environment's observations have no such two vectors.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        parts = getattr(env.observation_space, "spaces", {})
        numbers, choices = parts.get("continuous"), parts.get("discrete")
        if not isinstance(numbers, spaces.Box) or not isinstance(choices, spaces.MultiDiscrete):
            raise ConfigError(
                "JoinedObservations needs a flattened view, with a Box under 'continuous' and a "
                f"MultiDiscrete under 'discrete', but found {env.observation_space!r}. Put "
                "FlattenerWrapper inside it."
            )
        sizes = np.asarray(choices.nvec, np.int64)
        self._sizes = tuple(sizes.tolist())
        self._count = int(sizes.sum())
        self._places = np.concatenate([[0], np.cumsum(sizes)[:-1]]) - choices.start
        bounds = (
            np.concatenate([numbers.low, np.zeros(self._count, np.float32)]),
            np.concatenate([numbers.high, np.ones(self._count, np.float32)]),
        )
        joined = spaces.Box(*bounds, dtype=np.float32)
        rest = {key: part for key, part in parts.items() if key not in ("continuous", "discrete")}
        self.observation_space = (
            spaces.Dict({"observation": joined, **copy.deepcopy(rest)}) if rest else joined
        )
        self._keys = tuple(getattr(self.observation_space, "spaces", ()))

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if not plan.is_flat or plan.joined:
            return False
        plan.joined = self._sizes
        return True

    def observation(self, observation: Any) -> Any:
        """The observation as one vector, ``(..., n + v)``, and what stands beside it."""
        choices = np.asarray(observation["discrete"], np.int64) + self._places
        ones = np.zeros((*choices.shape[:-1], self._count), np.float32)
        np.put_along_axis(ones, choices, 1.0, axis=-1)
        joined = np.concatenate([observation["continuous"], ones], axis=-1, dtype=np.float32)
        if not self._keys:
            return joined
        seen = {**observation, "observation": joined}
        return {key: seen[key] for key in self._keys}
