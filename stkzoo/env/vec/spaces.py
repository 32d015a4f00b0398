"""Spaces whose values stack into one array with a row per slot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gymnasium import spaces

from stkzoo.errors import ConfigError


def shared_space(by_agent: Mapping[str, spaces.Space[Any]], kind: str) -> spaces.Space[Any]:
    """Returns the space that all agents share, whose values stack into one array.

    Args:
        by_agent: each agent's space.
        kind: ``"observation"`` or ``"action"``.

    Raises:
        ConfigError: the spaces differ, or their values differ in size.
    """
    first, *others = by_agent.values()
    if any(space != first for space in others):
        raise ConfigError(
            f"the agents differ in their {kind} spaces: {dict(by_agent)}; give all "
            "agents the same view, and use_ai to all of them or to none"
        )
    if not is_of_fixed_size(first):
        raise ConfigError(
            f"the {kind} space is a {type(first).__name__} whose values differ in size; choose "
            'view="simple", one of the flattened views, or your own view with Box, Discrete, '
            "MultiDiscrete, MultiBinary, Text and Dict spaces"
        )
    return first


def is_of_fixed_size(space: spaces.Space[Any]) -> bool:
    """Whether all values of a space have the same size, so that they stack into one array."""
    if isinstance(space, spaces.Dict):
        return all(map(is_of_fixed_size, space.spaces.values()))
    kinds = spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary, spaces.Text
    return isinstance(space, kinds)
