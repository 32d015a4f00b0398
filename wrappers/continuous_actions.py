"""Acceleration and steering only."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from stkzoo.errors import ConfigError
from stkzoo.views.bases import ActionObservationWrapper, CompiledWrapper
from stkzoo.wrappers.arguments import dict_space, observed_action, with_observed_action

if TYPE_CHECKING:
    from stkzoo.views.plan import ViewPlan

__all__ = ["OnlyContinuousActionsWrapper"]


class OnlyContinuousActionsWrapper(ActionObservationWrapper, CompiledWrapper):
    """Keeps the continuous parts of an action; no button is ever pressed.

    The game AI's own ``action``, where the observation carries it, loses its buttons too.

    Attributes:
        discrete_actions: the space of what is left out.

    Raises:
        ConfigError: the environment's actions have no continuous part.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        space = dict_space(env.action_space, "actions", "OnlyContinuousActionsWrapper")
        parts = copy.deepcopy(space.spaces)
        self._boxes: dict[str, spaces.Space[Any]] = {
            key: part for key, part in parts.items() if isinstance(part, spaces.Box)
        }
        if not self._boxes:
            raise ConfigError(
                f"OnlyContinuousActionsWrapper found only discrete actions ({', '.join(parts)}); "
                "it does not go together with DiscreteActionsWrapper."
            )
        self.discrete_actions = spaces.Dict(
            {key: part for key, part in parts.items() if isinstance(part, spaces.Discrete)}
        )
        self.action_space = spaces.Dict(self._boxes)
        self._has_action = observed_action(env.observation_space) is not None
        self.observation_space = with_observed_action(env.observation_space, self.action_space)

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if plan.has_action or "" in plan.leaves:
            return False
        plan.leaves = {key: plan.leaves[key] for key in self._boxes}
        return True

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        """The action with all buttons 0."""
        key, box = next(iter(self._boxes.items()))
        shape = np.shape(action[key])
        lead = shape[: max(len(shape) - len(box.shape or ()), 0)]
        return {
            **action,
            **{key: np.zeros(lead, np.int64) if lead else 0 for key in self.discrete_actions},
        }

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """The observation with the continuous part of the AI's ``action``, if it has one."""
        if not self._has_action:
            return observation
        action = observation["action"]
        return {**observation, "action": {key: action[key] for key in self._boxes}}
