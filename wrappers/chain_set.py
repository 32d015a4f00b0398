"""The chains of several agents, each run by itself on the single form."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, TypeAlias

from gymnasium import spaces
from gymnasium.wrappers.utils import create_zero_array

from stkzoo.errors import ConfigError
from stkzoo.wrappers.agent_chain import AgentChain, WrapperFactory
from stkzoo.wrappers.agent_names import by_agent
from stkzoo.wrappers.batch import split

__all__ = ["ChainSet", "Factories"]

#: Wrapper factories by agent: id, number or number as a string.
Factories: TypeAlias = Mapping[Any, WrapperFactory]


class ChainSet:
    """One :class:`AgentChain` for each agent.

    Attributes:
        chains: the chains by agent.

    Args:
        observation_spaces: the agents' base observation spaces.
        action_spaces: the agents' base action spaces.
        factories: what wraps an agent's environment; agents left out have no wrappers.

    Raises:
        ConfigError: a factory is for no agent or cannot be called, or the spaces are not
            for the same agents.
        AgentException: a factory failed.
    """

    def __init__(
        self,
        observation_spaces: Mapping[str, spaces.Space[Any]],
        action_spaces: Mapping[str, spaces.Space[Any]],
        factories: Factories,
    ) -> None:
        if observation_spaces.keys() != action_spaces.keys():
            raise ConfigError(
                f"observations are for agents {', '.join(observation_spaces)}, but actions for "
                f"{', '.join(action_spaces)}; expected the same agents."
            )
        found = by_agent(factories, observation_spaces)
        for agent, factory in found.items():
            if factory is not None and not callable(factory):
                raise ConfigError(
                    f"the wrapper factory of agent {agent!r} is {factory!r}; expected a callable "
                    "that takes an environment and returns it wrapped, or None."
                )
        self.chains = {
            agent: AgentChain(agent, space, action_spaces[agent], found.get(agent))
            for agent, space in observation_spaces.items()
        }

    def reset(
        self,
        observations: Mapping[str, Any],
        infos: Mapping[str, dict[str, Any]],
        seed: int | None,
        options: dict[str, Any] | None,
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Resets the wrappers of all agents that have an observation.

        Agent number ``n`` is seeded with ``seed + n``.
        """
        changed: dict[str, Any] = {}
        new_infos: dict[str, dict[str, Any]] = {}
        for number, (agent, chain) in enumerate(self.chains.items()):
            if agent in observations:
                changed[agent], new_infos[agent] = chain.reset(
                    observations[agent],
                    infos.get(agent, {}),
                    seed=None if seed is None else seed + number,
                    options=None if options is None else dict(options),
                )
        return changed, new_infos

    def begin_step(self, actions: Mapping[str, Any], present: Collection[str]) -> dict[str, Any]:
        """Base actions, in single form, for the agents that have an action.

        Args:
            actions: actions by agent; all are checked before any wrapper sees one.
            present: the agents whose episode goes on; those without an action get no base
                action, but their wrappers see an action of zeros.

        Raises:
            ActionError: an action is not in its agent's space.
            AgentException: a wrapper failed.
        """
        checked = {
            agent: self.chains[agent].read_action(actions[agent])
            for agent in present
            if agent in actions
        }
        base: dict[str, Any] = {}
        try:
            for agent in present:
                chain = self.chains[agent]
                if agent in checked:
                    batch = chain.begin_base_step(checked[agent])
                    base[agent] = split(chain.base_action_space, batch)[0]
                else:
                    chain.begin_step(create_zero_array(chain.action_space))
        except BaseException:
            self.abandon()
            raise
        return base

    def abandon(self) -> None:
        """Forgets steps that were begun and will not be finished."""
        for chain in self.chains.values():
            chain.abandon()

    def close(self) -> None:
        """Closes all wrappers."""
        for chain in self.chains.values():
            chain.close()
