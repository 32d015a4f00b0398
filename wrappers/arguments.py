"""What the wrappers ask of the arguments and spaces they are constructed with."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from gymnasium import spaces

from stkzoo.errors import ConfigError

__all__ = ["dict_space", "observed_action", "whole_number", "with_observed_action"]


def whole_number(name: str, value: object, minimum: int) -> int:
    """Returns ``value`` as an ``int`` of at least ``minimum``.

    Raises:
        ConfigError: it is no whole number, or too small.
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < minimum:
        raise ConfigError(f"{name} is {value!r}; expected a whole number of at least {minimum}.")
    return int(value)


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
            f"{wrapper} needs {what} in a Dict space, but found {space!r}. "
            "Put it inside the wrappers that flatten, not around them."
        )
    return space


def observed_action(space: spaces.Space[Any]) -> spaces.Space[Any] | None:
    """The space of the game AI's own ``action`` in an observation space, if it is there."""
    return space.spaces.get("action") if isinstance(space, spaces.Dict) else None


def with_observed_action(
    space: spaces.Space[Any], action_space: spaces.Space[Any]
) -> spaces.Space[Any]:
    """The observation space with the AI's ``action``, where there is one, in another space."""
    if not isinstance(space, spaces.Dict) or "action" not in space.spaces:
        return space
    entries = copy.deepcopy(space.spaces)
    return spaces.Dict({**entries, "action": copy.deepcopy(action_space)})
