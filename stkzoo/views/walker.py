"""The chains of several agents, run one agent at a time."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias, cast

from gymnasium import spaces
from gymnasium.wrappers.utils import create_zero_array

from stkzoo._checks import shortened
from stkzoo.agent_names import by_agent
from stkzoo.errors import ConfigError
from stkzoo.views.agent_chain import AgentChain
from stkzoo.views.registry import find_view
from stkzoo.views.split_step import AgentStep

if TYPE_CHECKING:
    from stkzoo.wrappers.camera import Camera

#: Observations, rewards, terminations, truncations and infos, each by agent.
StepParts: TypeAlias = tuple[
    dict[str, Any],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, dict[str, Any]],
]


#: Views by agent (id, number or number as a string), as :func:`~stkzoo.views.find_view` accepts
#: them; ``None`` adds no wrappers.
Factories: TypeAlias = Mapping[Any, object]

_Dicts: TypeAlias = tuple[dict[str, Any], ...]


class ChainWalker:
    """One :class:`AgentChain` per agent, run one agent at a time.

    Attributes:
        chains: chains by agent.
        observation_spaces: each agent's observation space, after its wrappers.
        action_spaces: each agent's action space, before its wrappers.

    Args:
        observation_spaces: the agents' base observation spaces.
        action_spaces: the agents' base action spaces.
        factories: views by agent; agents that are missing or ``None`` have no wrappers.
        cameras: cameras by agent, if the race can render.

    Raises:
        ConfigError: a view belongs to no agent, is unknown, or rejects its environment or options.
        AgentException: a factory failed, or did not return a wrapper of its argument.
    """

    def __init__(
        self,
        observation_spaces: Mapping[str, spaces.Space[Any]],
        action_spaces: Mapping[str, spaces.Space[Any]],
        factories: Factories,
        cameras: Mapping[str, Camera] | None = None,
    ) -> None:
        if observation_spaces.keys() != action_spaces.keys():
            raise ConfigError(
                f"observations are for {shortened([*observation_spaces], 40)}, but actions for "
                f"{shortened([*action_spaces], 40)}; expected an environment of several agents"
            )
        chosen = by_agent(factories, observation_spaces)
        views = {agent: find_view(view) for agent, view in chosen.items() if view is not None}
        self.chains = {
            agent: AgentChain(
                agent, space, action_spaces[agent], views.get(agent), (cameras or {}).get(agent)
            )
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
            observations: first observations of the race by agent; replaced by the wrapped ones.
            infos: first infos of the race by agent; replaced by the wrapped ones.
            seed: agent ``n`` gets ``seed + n`` as an ``int``, which Gymnasium requires.
            options: passed to the ``reset`` of every wrapper.

        Raises:
            AgentException: a wrapper failed.
        """
        for number, (agent, chain) in enumerate(self.chains.items()):
            chain.num_clipped = 0
            if agent in agents:
                observations[agent], infos[agent] = chain.reset(
                    observations[agent],
                    infos.get(agent, {}),
                    seed=None if seed is None else int(seed) + number,
                    options=None if options is None else dict(options),
                )

    def read_actions(self, actions: Mapping[str, Any], agents: Collection[str]) -> dict[str, Any]:
        """Checks actions and returns them in Gymnasium's form; no wrapper runs.

        Args:
            actions: actions by agent.
            agents: the agents; those without an action are left out.

        Raises:
            ActionError: an action is not in its agent's space.
        """
        acting = [agent for agent in agents if agent in actions]
        return {agent: self.chains[agent].read_action(actions[agent]) for agent in acting}

    def begin_step(self, actions: Mapping[str, Any], agents: Collection[str]) -> dict[str, Any]:
        """Runs the first half of the wrappers' steps.

        Args:
            actions: actions from :meth:`read_actions`.
            agents: agents whose wrappers run. The wrappers of agents without an action get an
                action of zeros, and the result has no base action for them.

        Returns:
            Checked base actions of the agents with an action.

        Raises:
            ActionError: a wrapper returned an action outside its agent's base space.
            AgentException: a wrapper failed.
        """
        base: dict[str, Any] = {}
        for agent in agents:
            chain = self.chains[agent]
            if agent in actions:
                base[agent] = chain.begin_step(actions[agent])
            else:
                chain.begin_step(create_zero_array(chain.action_space))
        return base

    def finish_step(self, agents: Collection[str], parts: StepParts) -> None:
        """Runs the second half of the wrappers' steps; call it once after :meth:`begin_step`.

        Args:
            agents: the agents.
            parts: result of the step; replaced by the wrapped results.

        Raises:
            AgentException: a wrapper failed; the agents after this one have not finished the step.
        """
        for agent in agents:
            wrapped = self.chains[agent].finish_step(_part(parts, agent))
            for part, value in zip(cast(_Dicts, parts), wrapped, strict=True):
                part[agent] = value

    def abandon(self) -> None:
        """Discards steps that have begun and will not be finished."""
        for chain in self.chains.values():
            chain.abandon()

    def close(self) -> None:
        """Closes all wrappers."""
        for chain in self.chains.values():
            chain.close()


def _part(result: StepParts, agent: str) -> AgentStep:
    """Returns one agent's part of a step's result, with a copy of its info."""
    observations, rewards, terminations, truncations, infos = result
    info = dict(infos[agent])
    return observations[agent], rewards[agent], terminations[agent], truncations[agent], info
