"""Lookup of agents by id or number."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, TypeVar

from stkzoo._checks import shortened, unknown_name
from stkzoo.errors import ActionError, ConfigError

__all__ = ["actions_by_agent", "agent_named", "by_agent", "find_agent", "of_agent"]

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
    agent = agent_named(name, agents)
    if agent is None:
        raise unknown_name("agent", name, agents)
    return agent


def agent_named(name: object, agents: Iterable[str]) -> str | None:
    """Returns the id of an agent, as :func:`find_agent` does; ``None`` if there is no agent."""
    if isinstance(name, str) and name in agents:
        return name
    if not isinstance(name, (int, str)) or isinstance(name, bool) or not str(name).isdecimal():
        return None
    number = str(int(name))
    return next((agent for agent in agents if agent.rpartition("_")[2] == number), None)


def of_agent(values: Mapping[str, Value], agent: object) -> Value:
    """Returns the value of an agent.

    Args:
        values: values by id of the agent.
        agent: the agent, as in :func:`find_agent`.

    Raises:
        ConfigError: there is no such agent; the error text lists the agents.
    """
    return values[find_agent(agent, values)]


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


def actions_by_agent(
    actions: object, agents: Sequence[str], optional: Collection[str] = ()
) -> dict[str, Any]:
    """Returns the actions of agents by id, and checks that there is one for every agent.

    Args:
        actions: actions by agent, as in :func:`find_agent`. Those of other agents are left out.
        agents: ids of the agents that act.
        optional: agents that need no action.

    Raises:
        ActionError: an action is missing, or the actions are not a dict.
    """
    if not isinstance(actions, Mapping):
        raise ActionError(
            f"the actions are {shortened(actions)}; expected a dict with an action for each of "
            f"{', '.join(map(repr, agents))}",
            agents[0] if agents else "",
        )
    by_id = {agent_named(name, agents): action for name, action in actions.items()}
    acting = {agent: by_id[agent] for agent in agents if agent in by_id}
    missing = [agent for agent in agents if agent not in acting and agent not in optional]
    if missing:
        came = ", ".join(map(repr, actions)) or "none"
        raise ActionError(
            f"no action for agent {', '.join(map(repr, missing))}; actions came for {came}. "
            "Send one for every agent in env.agents.",
            missing[0],
        )
    return acting
