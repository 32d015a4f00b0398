"""The ways in which a user may name an agent."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeVar

from stkzoo.errors import ConfigError, unknown_name

__all__ = ["by_agent", "find_agent", "of_agent"]

Value = TypeVar("Value")


def find_agent(name: object, agents: Iterable[str]) -> str:
    """The id of the agent that is meant.

    Args:
        name: an agent's id (``"kart_0"``), its number (``0``) or that as a string (``"0"``).
        agents: the ids of all agents.

    Raises:
        ConfigError: none of them is meant; the text lists them.

    Example:
        >>> find_agent(1, ["kart_0", "kart_1"])
        'kart_1'
    """
    agents = list(agents)
    if isinstance(name, str) and name in agents:
        return name
    if isinstance(name, (int, str)) and not isinstance(name, bool) and str(name).isdecimal():
        for agent in agents:
            if agent.rpartition("_")[2] == str(int(name)):
                return agent
    raise unknown_name("agent", name, agents)


def of_agent(values: Mapping[str, Value], agent: str) -> Value:
    """The value of the agent with this id.

    Raises:
        ConfigError: there is no such agent; the text lists them.
    """
    if agent not in values:
        raise unknown_name("agent", agent, values)
    return values[agent]


def by_agent(values: Mapping[object, Value], agents: Iterable[str]) -> dict[str, Value]:
    """The same values under the agents' ids.

    Raises:
        ConfigError: a key means no agent, or two keys mean the same one.
    """
    agents = list(agents)
    found: dict[str, Value] = {}
    for name, value in values.items():
        agent = find_agent(name, agents)
        if agent in found:
            raise ConfigError(f"agent {agent!r} is named twice; the second time as {name!r}.")
        found[agent] = value
    return found
