"""Wrappers of single agents on an environment of many."""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping
from typing import Any, TypeAlias, cast

import gymnasium as gym
from gymnasium import spaces
from gymnasium.wrappers.utils import create_zero_array
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from stkzoo.agent_names import by_agent
from stkzoo.errors import ConfigError
from stkzoo.views.actions import split
from stkzoo.views.agent_chain import AgentChain, WrapperFactory

#: Wrapper factories by agent: id, number or number as a string.
Factories: TypeAlias = Mapping[Any, WrapperFactory]


class MonoAgentWrapperAdapter:
    """Gives each agent of an environment its own wrappers.

    Around a Gymnasium environment whose spaces are ``Dict`` by agent
    (``supertuxkart/multi-full-v0``) this is a Gymnasium wrapper,
    :class:`GymAgentAdapter`; around a PettingZoo ``ParallelEnv`` it is a ``ParallelEnv``,
    :class:`ParallelAgentAdapter`. Any Gymnasium wrapper may be used, with a ``step`` or
    ``reset`` of its own too: it is reset with the race, and what it does to the reward,
    the ends and the info of its agent counts.

    Args:
        env: the environment of many agents.
        keep_original: also hand out what each agent would see without its wrappers, as
            copies. The Gymnasium form adds ``original/<agent>`` to the observations; in
            the ``ParallelEnv`` form each observation becomes ``{"observation": wrapped,
            "original": unwrapped}``, in the spaces too.
        wrapper_factories: for an agent, named by id, number or number as a string, what
            wraps its environment. Agents that are left out, or ``None``, have no wrappers.

    Raises:
        ConfigError: ``env`` is of neither kind, or a name is no agent's.
        AgentException: a factory or (later) a wrapper failed; ``key`` names the agent.
    """

    def __new__(cls, env: Any = None, **_: Any) -> MonoAgentWrapperAdapter:
        """Chooses the form that fits the environment."""
        if cls is not MonoAgentWrapperAdapter:
            return super().__new__(cls)
        if isinstance(env, ParallelEnv):
            return super().__new__(ParallelAgentAdapter)
        if isinstance(env, gym.Env):
            return super().__new__(GymAgentAdapter)
        raise ConfigError(
            f"MonoAgentWrapperAdapter goes around a ParallelEnv or a gymnasium.Env, not {env!r}."
        )

    def __init__(
        self, env: Any, *, keep_original: bool = False, wrapper_factories: Factories
    ) -> None: ...


class GymAgentAdapter(
    MonoAgentWrapperAdapter, gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs
):
    """:class:`MonoAgentWrapperAdapter` around a Gymnasium environment.

    Rewards of single agents are read from ``info["reward"]`` and ends from
    ``info["terminated"]``, dicts by agent, where the environment gives them; the changed
    ones take their place, together with ``info["truncated"]`` and ``info["infos"]``,
    and the scalar reward moves by the sum of the changes. Agents that are not in the
    observations or actions of a step are passed over.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        *,
        keep_original: bool = False,
        wrapper_factories: Factories,
    ) -> None:
        gym.utils.RecordConstructorArgs.__init__(
            self, keep_original=bool(keep_original), wrapper_factories=dict(wrapper_factories)
        )
        gym.Wrapper.__init__(self, env)
        self.keep_original = bool(keep_original)
        observation_spaces = _spaces_by_agent(env.observation_space)
        action_spaces = _spaces_by_agent(env.action_space)
        self._set = _AgentWrappers(observation_spaces, action_spaces, wrapper_factories)
        self._present: tuple[str, ...] = ()
        self.action_space = spaces.Dict({a: c.action_space for a, c in self._set.chains.items()})
        observed = {agent: chain.observation_space for agent, chain in self._set.chains.items()}
        if self.keep_original:
            for agent, space in observation_spaces.items():
                observed[f"original/{agent}"] = copy.deepcopy(space)
        self.observation_space = spaces.Dict(observed)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Resets the environment and all wrappers."""
        observations, info = self.env.reset(seed=seed, options=options)
        infos = info.get("infos", {})
        originals = self._copies(observations)
        changed, new_infos = self._set.reset(observations, infos, seed, options)
        self._present = tuple(changed)
        info = {**info, "infos": {**infos, **new_infos}} if "infos" in info else dict(info)
        return {**changed, **originals}, info

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Steps the environment with the base actions of the agents' actions."""
        base = self._set.begin_step(actions, self._present)
        try:
            observations, reward, terminated, truncated, info = self.env.step(base)
            originals = self._copies(observations)
            results = {
                agent: self._set.chains[agent].finish_step(
                    _agent_part(agent, observation, info, (terminated, truncated))
                )
                for agent, observation in observations.items()
                if agent in self._set.chains
            }
        finally:
            self._set.abandon()
        self._present = tuple(results)
        changed = {agent: result[0] for agent, result in results.items()}
        gains = (float(r[1]) - _reward(agent, info) for agent, r in results.items())
        ends = [(r[2], r[3]) for r in results.values()]
        if "terminated" in info and ends and all(map(any, ends)) and not (terminated or truncated):
            terminated = all(end[0] for end in ends)
            truncated = not terminated
        return (
            {**changed, **originals},
            float(reward) + sum(gains),
            bool(terminated),
            bool(truncated),
            _changed_info(info, results),
        )

    def close(self) -> None:
        """Closes all wrappers and the environment."""
        self._set.close()
        super().close()

    def _copies(self, observations: Mapping[str, Any]) -> dict[str, Any]:
        """What is handed out beside the wrapped observations; taken before wrappers run."""
        if not self.keep_original:
            return {}
        known = self._set.chains.keys() & observations.keys()
        return {f"original/{agent}": copy.deepcopy(observations[agent]) for agent in known}


class ParallelAgentAdapter(MonoAgentWrapperAdapter, BaseParallelWrapper[str, Any, Any]):
    """:class:`MonoAgentWrapperAdapter` around a PettingZoo ``ParallelEnv``.

    An agent whose wrapper ends its episode early leaves ``agents``; its kart stays in the
    race with an action of zeros.
    """

    def __init__(
        self,
        env: ParallelEnv[str, Any, Any],
        *,
        keep_original: bool = False,
        wrapper_factories: Factories,
    ) -> None:
        BaseParallelWrapper.__init__(self, env)
        self.keep_original = bool(keep_original)
        self._retired: frozenset[str] = frozenset()
        agents = env.possible_agents
        self._set = _AgentWrappers(
            {agent: env.observation_space(agent) for agent in agents},
            {agent: env.action_space(agent) for agent in agents},
            wrapper_factories,
        )
        self._observation_spaces = {
            agent: self._handed_out_space(chain) for agent, chain in self._set.chains.items()
        }

    def _handed_out_space(self, chain: AgentChain) -> spaces.Space[Any]:
        if not self.keep_original:
            return chain.observation_space
        original = copy.deepcopy(chain.base_observation_space)
        return spaces.Dict({"observation": chain.observation_space, "original": original})

    @property
    def agents(self) -> list[str]:
        """The agents whose episode goes on."""
        return [agent for agent in self.env.agents if agent not in self._retired]

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """What the agent sees; the same object each time."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """What the agent chooses from; the same object each time."""
        return self._set.chains[agent].action_space

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Resets the environment and all wrappers."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self._retired = frozenset()
        originals = self._copies(observations)
        changed, new_infos = self._set.reset(observations, infos, seed, options)
        return self._with_originals(changed, originals), new_infos

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[
        dict[str, Any],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Steps the environment with the base actions of the agents' actions."""
        agents = self.agents
        if not agents:
            return {}, {}, {}, {}, {}
        chains = self._set.chains
        base = self._set.begin_step(actions, agents)
        for agent in self._retired.intersection(self.env.agents):
            base[agent] = create_zero_array(chains[agent].base_action_space)
        try:
            observations, *parts = self.env.step(base)
            originals = self._copies(observations)
            results = {
                agent: chains[agent].finish_step(
                    (observations[agent], *(part[agent] for part in parts))
                )
                for agent in agents
                if agent in observations
            }
        finally:
            self._set.abandon()
        self._retired |= {agent for agent, r in results.items() if r[2] or r[3]}
        return (
            self._with_originals({a: r[0] for a, r in results.items()}, originals),
            {agent: float(r[1]) for agent, r in results.items()},
            {agent: r[2] for agent, r in results.items()},
            {agent: r[3] for agent, r in results.items()},
            {agent: r[4] for agent, r in results.items()},
        )

    def close(self) -> None:
        """Closes all wrappers and the environment."""
        self._set.close()
        super().close()

    def _with_originals(
        self, changed: dict[str, Any], originals: Mapping[str, Any]
    ) -> dict[str, Any]:
        if not self.keep_original:
            return changed
        return {
            agent: {"observation": observation, "original": originals[agent]}
            for agent, observation in changed.items()
        }

    def _copies(self, observations: Mapping[str, Any]) -> Mapping[str, Any]:
        """Copies of unwrapped observations, if they are asked for; taken before wrappers run."""
        return copy.deepcopy(dict(observations)) if self.keep_original else {}


class _AgentWrappers:
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


def _spaces_by_agent(space: spaces.Space[Any]) -> dict[str, spaces.Space[Any]]:
    if not isinstance(space, spaces.Dict):
        raise ConfigError(f"expected a Dict space by agent, but found {space!r}.")
    return dict(space.spaces)


def _reward(agent: str, info: Mapping[str, Any]) -> float:
    return float(info.get("reward", {}).get(agent, 0.0))


def _agent_part(
    agent: str, observation: Any, info: Mapping[str, Any], ends: tuple[bool, bool]
) -> tuple[Any, float, bool, bool, dict[str, Any]]:
    """One agent's share of a step of a Gymnasium environment of many."""
    terminated = bool(info.get("terminated", {}).get(agent, ends[0]))
    cut_short = ends[1] and not terminated
    return (
        observation,
        _reward(agent, info),
        terminated,
        bool(info.get("truncated", {}).get(agent, cut_short)),
        cast("dict[str, Any]", info.get("infos", {}).get(agent, {})),
    )


def _changed_info(info: Mapping[str, Any], results: Mapping[str, Any]) -> dict[str, Any]:
    """The info of a step with the agents' parts replaced, where it has such parts."""
    changed = dict(info)
    for place, key in ((1, "reward"), (2, "terminated"), (3, "truncated"), (4, "infos")):
        if key in info or (key == "truncated" and "terminated" in info):
            own = {agent: result[place] for agent, result in results.items()}
            changed[key] = {**info.get(key, {}), **own}
    if "done" in info:
        changed["done"] = {agent: result[2] or result[3] for agent, result in results.items()}
    return changed
