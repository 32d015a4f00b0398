"""What wrappers share: checks of arguments and spaces, and the base of other forms of actions."""

from __future__ import annotations

import copy
from typing import Any

from gymnasium import spaces

from stkzoo.errors import ConfigError
from stkzoo.views.bases import ActionObservationWrapper


def dict_space(space: spaces.Space[Any], what: str, wrapper: str) -> spaces.Dict:
    """Returns ``space``, which must be a ``Dict``.

    Args:
        space: the space that a wrapper is about to change.
        what: what it is a space of, such as ``"actions"``, for the message.
        wrapper: name of the wrapper that asks, for the message.

    Raises:
        ConfigError: the space is of another kind.
    """
    if not isinstance(space, spaces.Dict):
        raise ConfigError(
            f"{wrapper} needs {what} in a Dict space. Put it inside the wrappers that flatten, not "
            f"around them. Found {space!r:.200}"
        )
    return space


def observed_action(space: spaces.Space[Any]) -> spaces.Space[Any] | None:
    """The space of the game AI's own ``action`` in an observation space, if it is there."""
    return space.spaces.get("action") if isinstance(space, spaces.Dict) else None


class ActionFormWrapper(ActionObservationWrapper):
    """Another form of actions, also of the game AI's own ``action`` where it is observed."""

    def _change_action_space(self, space: spaces.Space[Any]) -> None:
        self.action_space = space
        seen = self.env.observation_space
        self._has_action = isinstance(seen, spaces.Dict) and "action" in seen.spaces
        if isinstance(seen, spaces.Dict) and self._has_action:
            parts = {**copy.deepcopy(seen.spaces), "action": copy.deepcopy(space)}
            self.observation_space = spaces.Dict(parts)

    def observed_action(self, action: Any) -> Any:
        """This wrapper's form of an action of the wrapped environment."""
        raise NotImplementedError

    def observation(self, observation: Any) -> Any:
        """The observation with the AI's ``action``, if it has one, in this wrapper's form."""
        if not self._has_action:
            return observation
        return {**observation, "action": self.observed_action(observation["action"])}
