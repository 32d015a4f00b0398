"""The chains of all agents of a race, each run once for all agents that share it."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.wrappers.utils import create_zero_array

from stkzoo.errors import ActionError, ConfigError
from stkzoo.wrappers.actions import read_actions
from stkzoo.wrappers.agent_chain import AgentChain, WrapperFactory, agent_failures
from stkzoo.wrappers.batch import split, take
from stkzoo.wrappers.memory import Memory

__all__ = ["AgentChains"]


@dataclass(frozen=True, slots=True)
class _Group:
    """Agents that share a chain, among the agents of one call."""

    chain: AgentChain
    agents: tuple[str, ...]
    rows: Sequence[int] | slice


class AgentChains:
    """Decodes the actions of all agents and makes each agent's view of what follows.

    Observations come in as one batch: the keys of the base observation space, each with
    the agents as leading axis (``Discrete`` and ``Text`` ``(A,)``, ``Box`` ``(A, *shape)``,
    ``Sequence`` ``(A, M, ...)``, ``Dict`` a dict of these); they go out by agent in
    Gymnasium's form. Agents whose wrappers are all :class:`BatchedWrapper`, of equal
    arguments around equal spaces, are run together. All other chains run agent by agent;
    a wrapper with a ``step`` of its own works too, and waits in a small thread while the
    race moves. What is handed out shares no memory with the batch or with earlier results.

    Attributes:
        observation_spaces: each agent's observation space, after its wrappers.
        action_spaces: each agent's action space, before its wrappers.
        paths_used: how many track segments the chains look at; ``None`` is all.

    Args:
        observation_spaces: each agent's base observation space.
        action_spaces: each agent's base action space, the same ``Dict`` for all.
        factories: wraps an agent's environment; agents that are left out, or ``None``,
            have no wrappers.
        ignored: agents that somebody else drives. They may leave out their action; it is
            not looked at, and their base action is all zeros.

    Raises:
        AgentException: a factory raised, or returned no wrapper of what it was given.
        ConfigError: the base action spaces differ, or a factory belongs to no agent.
    """

    def __init__(
        self,
        observation_spaces: Mapping[str, spaces.Space[Any]],
        action_spaces: Mapping[str, spaces.Space[Any]],
        factories: Mapping[str, WrapperFactory],
        ignored: Collection[str] = (),
    ) -> None:
        self._controls = _shared_space(action_spaces)
        strangers = [agent for agent in factories if agent not in observation_spaces]
        if strangers:
            raise ConfigError(
                f"wrappers for {', '.join(map(repr, strangers))}, who is no agent; the agents "
                f"are {', '.join(observation_spaces)}."
            )
        self._chains = {
            agent: AgentChain(agent, space, action_spaces[agent], factories.get(agent))
            for agent, space in observation_spaces.items()
        }
        self._numbers = {agent: number for number, agent in enumerate(self._chains)}
        self._identities: dict[str, Hashable] = {
            agent: chain.identity() if chain.is_batched else agent
            for agent, chain in self._chains.items()
        }
        self.paths_used = _most([chain.paths_used() for chain in self._chains.values()])
        self._ignored = frozenset(ignored)
        self._plan_key: tuple[str, ...] | None = None
        self._plan: list[_Group] = []
        self.observation_spaces = {a: chain.observation_space for a, chain in self._chains.items()}
        self.action_spaces = {a: chain.action_space for a, chain in self._chains.items()}

    def decode(
        self, actions: Mapping[str, Any], agents: Sequence[str]
    ) -> dict[str, npt.NDArray[Any]]:
        """The base actions for the agents' actions.

        All actions are checked before any wrapper sees one. Actions of others than
        ``agents`` are not looked at.

        Args:
            actions: actions by agent, in each agent's ``action_spaces``.
            agents: the agents that act.

        Returns:
            For each key of the base action space an array whose rows are ``agents``:
            ``(A, 1)`` float32 for ``acceleration`` and ``steer``, ``(A,)`` int64 for buttons.

        Raises:
            ActionError: an action is missing or not in its space.
            AgentException: a wrapper failed.
        """
        groups = self._groups(agents)
        self._require_actions(actions, agents)
        checked = [self._read(group, actions) for group in groups]
        controls = _zeros(self._controls, len(agents))
        try:
            for group, batch in zip(groups, checked, strict=True):
                if batch is not None:
                    self._decode_group(group, batch, controls)
        except BaseException:
            self._abandon()
            raise
        return controls

    def reset(
        self,
        agents: Sequence[str],
        batch_obs: Mapping[str, Any],
        infos: Mapping[str, dict[str, Any]],
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Resets all wrappers with the race's first observations.

        Args:
            agents: the agents, in the order of the batch's rows.
            batch_obs: base observations in batch form.
            infos: info by agent.
            seed: seeds the wrappers' ``np_random``: agent number ``n`` with ``seed + n``.
            options: handed to every wrapper's ``reset``.

        Returns:
            Observations and infos by agent.

        Raises:
            AgentException: a wrapper failed.
        """
        self._abandon()
        observations: dict[str, Any] = {}
        new_infos: dict[str, dict[str, Any]] = {}
        for group in self._groups(agents):
            for agent, observation in self._views(group, batch_obs):
                info = dict(infos[agent])
                if not group.chain.is_batched:
                    own_seed = None if seed is None else seed + self._numbers[agent]
                    own_options = None if options is None else dict(options)
                    observation, info = group.chain.reset(
                        observation, info, seed=own_seed, options=own_options
                    )
                observations[agent], new_infos[agent] = observation, info
        return _ordered(observations, agents), _ordered(new_infos, agents)

    def step(
        self,
        agents: Sequence[str],
        batch_obs: Mapping[str, Any],
        rewards: Mapping[str, float],
        terminations: Mapping[str, bool],
        truncations: Mapping[str, bool],
        infos: Mapping[str, dict[str, Any]],
    ) -> tuple[
        dict[str, Any],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """The agents' views of one step; call it once after each :meth:`decode`.

        Args:
            agents: the agents that acted, in the order of the batch's rows.
            batch_obs: base observations in batch form.
            rewards: reward by agent.
            terminations: whether the agent's race is over, by agent.
            truncations: whether its race was cut short, by agent.
            infos: info by agent.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent.

        Raises:
            AgentException: a wrapper failed.
        """
        results: dict[str, tuple[Any, float, bool, bool, dict[str, Any]]] = {}
        try:
            for group in self._groups(agents):
                for agent, observation in self._views(group, batch_obs):
                    result = (
                        observation,
                        float(rewards[agent]),
                        bool(terminations[agent]),
                        bool(truncations[agent]),
                        dict(infos[agent]),
                    )
                    results[agent] = (
                        result if group.chain.is_batched else _finished(group.chain, result)
                    )
        except BaseException:
            self._abandon()
            raise
        return (
            {agent: results[agent][0] for agent in agents},
            {agent: results[agent][1] for agent in agents},
            {agent: results[agent][2] for agent in agents},
            {agent: results[agent][3] for agent in agents},
            {agent: results[agent][4] for agent in agents},
        )

    def memory(self) -> dict[str, Memory | None]:
        """What each agent's wrappers remember between steps, as a value.

        Raises:
            AgentException: a wrapper holds something that cannot be copied.
        """
        return {agent: chain.memory() for agent, chain in self._chains.items()}

    def check_memory(self, memory: Mapping[str, Memory | None]) -> None:
        """Checks that :meth:`recall` can take a memory.

        Raises:
            AgentException: an agent's wrappers are others.
        """
        for agent, chain in self._chains.items():
            chain.check_memory(memory[agent])

    def recall(self, memory: Mapping[str, Memory | None]) -> None:
        """Makes the wrappers remember what :meth:`memory` gave, here or in equal chains.

        Raises:
            AgentException: an agent's wrappers are others.
        """
        for agent, chain in self._chains.items():
            chain.recall(memory[agent])

    def close(self) -> None:
        """Closes all wrappers."""
        for chain in self._chains.values():
            chain.close()

    def _groups(self, agents: Sequence[str]) -> list[_Group]:
        key = tuple(agents)
        if key != self._plan_key:
            members: dict[Hashable, list[int]] = {}
            for row, agent in enumerate(key):
                members.setdefault(self._identities[agent], []).append(row)
            self._plan = [self._group(key, rows) for rows in members.values()]
            self._plan_key = key
        return self._plan

    def _group(self, agents: tuple[str, ...], rows: list[int]) -> _Group:
        own = tuple(agents[row] for row in rows)
        return _Group(self._chains[own[0]], own, slice(None) if own == agents else rows)

    def _require_actions(self, actions: Mapping[str, Any], agents: Sequence[str]) -> None:
        if not isinstance(actions, Mapping):
            raise ActionError(
                f"the actions are {actions!r}; expected a dict by agent: {', '.join(agents)}.",
                agents[0] if agents else "",
            )
        missing = [a for a in agents if a not in actions and a not in self._ignored]
        if missing:
            came = ", ".join(map(repr, actions)) or "none"
            raise ActionError(
                f"no action for agent {', '.join(map(repr, missing))}; actions came for {came}. "
                "Send one for every agent in env.agents.",
                missing[0],
            )

    def _read(self, group: _Group, actions: Mapping[str, Any]) -> Any:
        """A group's actions in batch form; ``None`` if the group has nothing to decode."""
        chain = group.chain
        acting = [agent for agent in group.agents if agent not in self._ignored]
        if len(acting) == len(group.agents):
            return read_actions(chain.action_space, [actions[a] for a in acting], acting)
        if chain.is_batched and not acting:
            return None
        idle = create_zero_array(chain.action_space)
        chosen = [actions[agent] if agent in acting else idle for agent in group.agents]
        return read_actions(chain.action_space, chosen, group.agents)

    def _decode_group(
        self, group: _Group, batch: Any, controls: dict[str, npt.NDArray[Any]]
    ) -> None:
        chain = group.chain
        if chain.is_batched:
            with agent_failures(group.agents[0], "change its action"):
                base = chain.act(batch)
        else:
            base = chain.begin_base_step(split(chain.action_space, batch)[0])
        for key, column in controls.items():
            column[group.rows] = base[key]
        idle = [row for row, agent in _rows(group) if agent in self._ignored]
        for column in controls.values():
            column[idle] = 0

    def _views(self, group: _Group, batch_obs: Mapping[str, Any]) -> list[tuple[str, Any]]:
        """What a group's agents see: the final view of a batched group, else the base view."""
        chain = group.chain
        batch = take(chain.base_observation_space, batch_obs, group.rows)
        space = chain.base_observation_space
        if chain.is_batched:
            space = chain.observation_space
            with agent_failures(group.agents[0], "change its observation"):
                batch = chain.observe(batch)
        return list(zip(group.agents, split(space, batch), strict=True))

    def _abandon(self) -> None:
        for chain in self._chains.values():
            chain.abandon()


def _rows(group: _Group) -> list[tuple[int, str]]:
    """A group's agents with their rows."""
    rows = range(len(group.agents)) if isinstance(group.rows, slice) else group.rows
    return list(zip(rows, group.agents, strict=True))


def _finished(
    chain: AgentChain, result: tuple[Any, float, bool, bool, dict[str, Any]]
) -> tuple[Any, float, bool, bool, dict[str, Any]]:
    observation, reward, terminated, truncated, info = chain.finish_step(result)
    return observation, float(reward), terminated, truncated, info


def _shared_space(action_spaces: Mapping[str, spaces.Space[Any]]) -> spaces.Dict:
    """The one base action space of all agents."""
    found = list(action_spaces.values())
    first = found[0] if found else spaces.Dict()
    if not isinstance(first, spaces.Dict) or any(space != first for space in found):
        raise ConfigError(f"agents need one Dict space for all base actions, but have {found!r}.")
    return first


def _most(counts: Sequence[int | None]) -> int | None:
    known = [count for count in counts if count is not None]
    return max(known, default=None) if len(known) == len(counts) else None


def _zeros(space: spaces.Dict, count: int) -> dict[str, npt.NDArray[Any]]:
    return {
        key: np.zeros((count, *(part.shape or ())), part.dtype)
        for key, part in space.spaces.items()
    }


def _ordered(values: dict[str, Any], agents: Sequence[str]) -> dict[str, Any]:
    return {agent: values[agent] for agent in agents}
