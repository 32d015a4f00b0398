"""Lookup of agents by id or number."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TypeVar

from stkzoo._checks import shortened, unknown_name
from stkzoo.errors import ActionError, ConfigError

__all__ = ["by_agent", "find_agent", "of_agent", "require_actions"]

Value = TypeVar("Value")


def find_agent(name: object, agents: Iterable[str]) -> str:
    """Returns the id of an agent.

    Args:
        name: id of the agent (``"kart_0"``), its number (``0``) or the number as a string
            (``"0"``).
        agents: ids of all agents.

    Raises:
        ConfigError: there is no such agent; the error text lists the agents.

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
    """Returns the value of an agent.

    Args:
        values: values by id of the agent.
        agent: id of the agent.

    Raises:
        ConfigError: there is no such agent; the error text lists the agents.
    """
    if agent not in values:
        raise unknown_name("agent", agent, values)
    return values[agent]


def by_agent(values: Mapping[object, Value], agents: Iterable[str]) -> dict[str, Value]:
    """Returns values by id of the agent.

    Args:
        values: values by id or number of the agent, as in :func:`find_agent`.
        agents: ids of all agents.

    Raises:
        ConfigError: a key does not identify an agent, or two keys identify the same agent.
    """
    agents = list(agents)
    by_id: dict[str, Value] = {}
    for name, value in values.items():
        agent = find_agent(name, agents)
        if agent in by_id:
            raise ConfigError(f"agent {agent!r} is named twice; the second time as {name!r}.")
        by_id[agent] = value
    return by_id


def require_actions(actions: object, agents: Sequence[str], optional: Collection[str] = ()) -> None:
    """Checks that there is an action for every agent.

    Args:
        actions: actions by agent.
        agents: ids of the agents that act.
        optional: agents that need no action.

    Raises:
        ActionError: an action is missing, or the actions are not a dict.
    """
    if not isinstance(actions, Mapping):
        raise ActionError(
            f"the actions have to be a dict by agent: {', '.join(agents)}; found "
            f"{shortened(actions, 200)}",
            agents[0] if agents else "",
        )
    missing = [agent for agent in agents if agent not in actions and agent not in optional]
    if missing:
        came = ", ".join(map(repr, actions)) or "none"
        raise ActionError(
            f"no action for agent {', '.join(map(repr, missing))}; actions came for {came}. "
            "Send one for every agent in env.agents.",
            missing[0],
        )
