"""Checks of arguments and spaces, and the base class of wrappers that change actions."""

from __future__ import annotations

import copy
from typing import Any

from gymnasium import spaces

from stkzoo.errors import ConfigError
from stkzoo.views.bases import ActionObservationWrapper


def dict_space(space: spaces.Space[Any], what: str, wrapper: str) -> spaces.Dict:
    """Returns ``space`` if it is a ``Dict``.

    Args:
        space: the space to check.
        what: kind of values, such as ``"actions"``, for the message.
        wrapper: name of the wrapper, for the message.

    Raises:
        ConfigError: the space is not a ``Dict``.
    """
    if not isinstance(space, spaces.Dict):
        raise ConfigError(
            f"{wrapper} needs {what} in a Dict space. Put it inside the wrappers that flatten, not "
            f"around them. Found {space!r:.200}"
        )
    return space


class ActionFormWrapper(ActionObservationWrapper):
    """Base class of wrappers that change actions, including the AI's ``action`` in observations."""

    def _change_action_space(self, space: spaces.Space[Any]) -> None:
        self.action_space = space
        seen = self.env.observation_space
        self._has_action = isinstance(seen, spaces.Dict) and "action" in seen.spaces
        if isinstance(seen, spaces.Dict) and self._has_action:
            parts = {**copy.deepcopy(seen.spaces), "action": copy.deepcopy(space)}
            self.observation_space = spaces.Dict(parts)

    def observed_action(self, action: Any) -> Any:
        """Converts an action of the wrapped environment to one of this wrapper."""
        raise NotImplementedError

    def observation(self, observation: Any) -> Any:
        """Returns the observation with the AI's ``action``, if it has one, converted."""
        if not self._has_action:
            return observation
        return {**observation, "action": self.observed_action(observation["action"])}
