"""Several choices as one number."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.errors import ConfigError
from stkzoo.views.bases import ActionObservationWrapper, CompiledWrapper
from stkzoo.wrappers.arguments import observed_action, with_observed_action

if TYPE_CHECKING:
    from stkzoo.views.plan import ViewPlan

__all__ = ["FlattenMultiDiscreteActions"]


class FlattenMultiDiscreteActions(ActionObservationWrapper, CompiledWrapper):
    """Numbers all combinations of a ``MultiDiscrete`` action.

    The first choice varies fastest: number 1 differs from number 0 in the first choice.
    The game AI's own ``action``, where the observation carries it, becomes its number.

    Raises:
        ConfigError: the environment's action space is no ``MultiDiscrete`` vector.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        space = env.action_space
        if not isinstance(space, spaces.MultiDiscrete) or space.nvec.ndim != 1:
            raise ConfigError(
                f"FlattenMultiDiscreteActions needs a MultiDiscrete action space, but found "
                f"{space!r}. Put DiscreteActionsWrapper and FlattenerWrapper inside it."
            )
        self.nvec: npt.NDArray[np.int64] = space.nvec.astype(np.int64)
        self._start: npt.NDArray[np.int64] = space.start.astype(np.int64)
        self._strides = np.concatenate([[1], np.cumprod(self.nvec)[:-1]]).astype(np.int64)
        self.action_space = spaces.Discrete(int(np.prod(self.nvec)))
        self._has_action = observed_action(env.observation_space) is not None
        self.observation_space = with_observed_action(env.observation_space, self.action_space)

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if plan.has_action or not plan.has_choices:
            return False
        plan.number_choices(self.action(np.arange(np.prod(self.nvec))))
        return True

    def action(self, action: Any) -> npt.NDArray[np.int64]:
        """The choices ``(..., m)`` int64 that a number ``(...)`` stands for."""
        numbers = np.asarray(action, np.int64)[..., None]
        choices = numbers // self._strides
        # The last choice takes no remainder: a number that is too large stays too large.
        choices[..., :-1] %= self.nvec[:-1]
        return np.asarray(choices + self._start)

    def observation(self, observation: Any) -> Any:
        """The observation with the number of the AI's ``action``, if it has one."""
        if not self._has_action:
            return observation
        numbers = (np.asarray(observation["action"]) - self._start) @ self._strides
        return {**observation, "action": numbers if np.ndim(numbers) else int(numbers)}
