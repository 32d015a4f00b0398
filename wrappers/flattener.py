"""Observations and actions as plain vectors."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import gymnasium as gym
from gymnasium import spaces

from stkzoo.views.bases import ActionObservationWrapper, CompiledWrapper
from stkzoo.wrappers.arguments import dict_space, observed_action, with_observed_action
from stkzoo.wrappers.space_flattener import SpaceFlattener

if TYPE_CHECKING:
    from stkzoo.views.plan import ViewPlan

__all__ = ["FlattenerWrapper"]


class FlattenerWrapper(ActionObservationWrapper, CompiledWrapper):
    """Joins all numbers into one vector and all choices into another.

    The observation becomes ``{"continuous": (n,) float32, "discrete": (m,) int64}``, the
    entries in the order of their keys; ``kart_type``, a text, is left out. An action with
    numbers and choices becomes a dict of the same two keys; one with numbers only a plain
    ``Box``, one with choices only a plain ``MultiDiscrete``. The game AI's own ``action``,
    where the observation carries it, stays beside the two keys, in the flattened action
    space.

    Args:
        env: an environment whose observations have a fixed size.
        flatten_observations: ``False`` flattens only the actions.

    Raises:
        ConfigError: a space that is no ``Dict``, or an entry that cannot be flattened.
    """

    def __init__(self, env: gym.Env[Any, Any], flatten_observations: bool = True) -> None:
        gym.utils.RecordConstructorArgs.__init__(
            self, flatten_observations=bool(flatten_observations)
        )
        super().__init__(env)
        self.flatten_observations = bool(flatten_observations)
        self.has_action = observed_action(env.observation_space) is not None
        self.action_flattener = SpaceFlattener(
            dict_space(env.action_space, "actions", "FlattenerWrapper")
        )
        self.action_space = self.action_flattener.space
        if self.flatten_observations:
            space = dict_space(env.observation_space, "observations", "FlattenerWrapper")
            self.observation_flattener = SpaceFlattener(space)
            self.observation_space = self._flat_space()
        else:
            self.observation_space = with_observed_action(env.observation_space, self.action_space)

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        is_seen = not self.flatten_observations or (
            len(plan.sizes) == 3 and not (plan.is_flat or plan.sees_ground or plan.observer)
        )
        if plan.has_action or not is_seen or "" in plan.leaves:
            return False
        if self.flatten_observations:
            seen = self.observation_flattener
            plan.names, plan.is_flat = (*seen.continuous_keys, *seen.discrete_keys), True
        done = self.action_flattener
        groups = {"continuous": done.continuous_keys, "discrete": done.discrete_keys}
        leaves = {
            name: tuple(entry for key in keys for entry in plan.leaves[key])
            for name, keys in groups.items()
            if keys
        }
        plan.leaves = leaves if len(leaves) > 1 else {"": next(iter(leaves.values()))}
        return True

    def _flat_space(self) -> spaces.Space[Any]:
        flattener = self.observation_flattener
        if not self.has_action:
            return flattener.space
        parts = {"action": copy.deepcopy(self.action_space)}
        if isinstance(flattener.space, spaces.Dict):
            return spaces.Dict({**flattener.space.spaces, **parts})
        key = "continuous" if flattener.only_continuous else "discrete"
        return spaces.Dict({key: flattener.space, **parts})

    def observation(self, observation: dict[str, Any]) -> Any:
        """The observation as vectors, ``(..., n)`` and ``(..., m)``."""
        if not self.flatten_observations:
            flat: Any = dict(observation)
            if self.has_action:
                flat["action"] = self.action_flattener.flatten(observation["action"])
            return flat
        if not self.has_action:
            return self.observation_flattener.flatten(observation)
        flat = {"action": self.action_flattener.flatten(observation["action"])}
        if not self.observation_flattener.only_discrete:
            flat["continuous"] = self.observation_flattener.continuous(observation)
        if not self.observation_flattener.only_continuous:
            flat["discrete"] = self.observation_flattener.discrete(observation)
        return flat

    def action(self, action: Any) -> dict[str, Any]:
        """The action as a dict of its parts."""
        return self.action_flattener.unflatten(action)
