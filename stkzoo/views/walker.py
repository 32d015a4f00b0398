"""The chains of several agents, run agent by agent."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeAlias, cast

from gymnasium import spaces
from gymnasium.wrappers.utils import create_zero_array

from stkzoo.agent_names import by_agent
from stkzoo.errors import ConfigError
from stkzoo.views.agent_chain import AgentChain
from stkzoo.views.registry import find_view
from stkzoo.views.split_step import AgentStep

#: Observations, rewards, terminations, truncations and infos, each by agent.
StepParts: TypeAlias = tuple[
    dict[str, Any],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, dict[str, Any]],
]


#: Views by agent (id, number or number as a string), as :func:`~stkzoo.views.find_view` takes them;
#: ``None`` is no wrappers.
Factories: TypeAlias = Mapping[Any, object]

_Dicts: TypeAlias = tuple[dict[str, Any], ...]


class ChainWalker:
    """One :class:`AgentChain` for each agent, run agent by agent.

    Attributes:
        chains: the chains by agent.
        observation_spaces: each agent's observation space, after its wrappers.
        action_spaces: each agent's action space, before its wrappers.

    Args:
        observation_spaces: the agents' base observation spaces.
        action_spaces: the agents' base action spaces.
        factories: the agents' views; those that are left out, or ``None``, have no wrappers.

    Raises:
        ConfigError: a view is for no agent, unknown, or refuses its environment or options; or
            the spaces are not for the same agents.
        AgentException: a function raised, or returned no wrapper of what it was given.
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
        views = {agent: find_view(view) for agent, view in found.items() if view is not None}
        self.chains = {
            agent: AgentChain(agent, space, action_spaces[agent], views.get(agent))
            for agent, space in observation_spaces.items()
        }
        self.observation_spaces = {a: chain.observation_space for a, chain in self.chains.items()}
        self.action_spaces = {a: chain.action_space for a, chain in self.chains.items()}

    def reset(
        self,
        agents: Collection[str],
        observations: dict[str, Any],
        infos: dict[str, dict[str, Any]],
        seed: int | None,
        options: Mapping[str, Any] | None,
    ) -> None:
        """Resets the wrappers of some agents.

        Args:
            agents: the agents.
            observations: the race's first observations by agent; the wrappers' take their place.
            infos: likewise.
            seed: agent number ``n`` is seeded with ``seed + n``.
            options: handed to every wrapper's ``reset``.
        """
        for number, (agent, chain) in enumerate(self.chains.items()):
            if agent in agents:
                observations[agent], infos[agent] = chain.reset(
                    observations[agent],
                    infos.get(agent, {}),
                    seed=None if seed is None else seed + number,
                    options=None if options is None else dict(options),
                )

    def begin_step(self, actions: Mapping[str, Any], agents: Collection[str]) -> dict[str, Any]:
        """Runs the first half of the wrappers' steps.

        Args:
            actions: actions by agent; all are checked before any wrapper sees one.
            agents: the agents whose wrappers run; those without an action get no base action,
                but their wrappers see an action of zeros.

        Returns:
            Checked base actions of the agents that have an action.

        Raises:
            ActionError: an action is not in its agent's space.
            AgentException: a wrapper failed.
        """
        own = [agent for agent in agents if agent in actions]
        checked = {agent: self.chains[agent].read_action(actions[agent]) for agent in own}
        base: dict[str, Any] = {}
        with self._abandoned_after_failure():
            for agent in agents:
                chain = self.chains[agent]
                if agent in checked:
                    base[agent] = chain.begin_base_step(checked[agent])
                else:
                    chain.begin_step(create_zero_array(chain.action_space))
        return base

    def finish_step(self, agents: Collection[str], parts: StepParts) -> None:
        """Runs the second half of the wrappers' steps; call it once after :meth:`begin_step`.

        Args:
            agents: the agents.
            parts: what happened to them; the wrappers' answers take its place.

        Raises:
            AgentException: a wrapper failed.
        """
        with self._abandoned_after_failure():
            for agent in agents:
                own = self.chains[agent].finish_step(_part(parts, agent))
                for part, value in zip(cast(_Dicts, parts), own, strict=True):
                    part[agent] = value

    @contextmanager
    def _abandoned_after_failure(self) -> Iterator[None]:
        """Abandons the steps under way when the block fails."""
        try:
            yield
        except BaseException:
            self.abandon()
            raise

    def abandon(self) -> None:
        """Forgets steps that were begun and will not be finished."""
        for chain in self.chains.values():
            chain.abandon()

    def close(self) -> None:
        """Closes all wrappers."""
        for chain in self.chains.values():
            chain.close()


def _part(result: StepParts, agent: str) -> AgentStep:
    """One agent's part of a step's result, its info a copy."""
    observations, rewards, terminations, truncations, infos = result
    info = dict(infos[agent])
    return observations[agent], rewards[agent], terminations[agent], truncations[agent], info
