"""The chains of all agents of a race, each run once for all agents that share it."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, cast

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.wrappers.utils import create_zero_array

from stkzoo.errors import ActionError, ConfigError
from stkzoo.kernel import kernel
from stkzoo.mdp.spaces import shows_ground
from stkzoo.views.actions import read_actions
from stkzoo.views.agent_chain import AgentChain, WrapperFactory, agent_failures
from stkzoo.views.batch import split, take
from stkzoo.views.memory import Memory
from stkzoo.views.split_step import AgentStep

__all__ = ["AgentChains", "Sight"]


#: Observations, rewards, terminations, truncations and infos, each by agent.
StepParts: TypeAlias = tuple[
    dict[str, Any],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, dict[str, Any]],
]


_Dicts: TypeAlias = tuple[dict[str, Any], ...]


class Sight(Protocol):
    """What the agents of one call see at one moment, made in the form that is asked for."""

    def batch(self) -> Mapping[str, Any]:
        """All agents' base observations in batch form."""

    def through(self, view: Any, rows: npt.NDArray[np.intp]) -> list[Any] | None:
        """What some agents see in a view that needs no batch, in Gymnasium's form.

        Args:
            view: of :func:`stkzoo.views.compile.fused_view`.
            rows: which agents.

        Returns:
            One observation an agent; ``None`` if only :meth:`batch` can be had.
        """


@dataclass(frozen=True, slots=True)
class _Group:
    """Agents that share a chain, among the agents of one call."""

    chain: AgentChain
    agents: tuple[str, ...]
    rows: npt.NDArray[np.intp]
    is_all: bool
    has_ignored: bool
    view: Any
    controls: Any


class AgentChains:
    """Decodes the actions of all agents and makes each agent's view of what follows.

    Observations come in as a :class:`Sight`, whose batch form has the keys of the base
    observation space, each with the agents as leading axis (``Discrete`` and ``Text``
    ``(A,)``, ``Box`` ``(A, *shape)``, ``Sequence`` ``(A, M, ...)``, ``Dict`` a dict of
    these); they go out by agent in Gymnasium's form. Agents whose wrappers are all
    :class:`BatchedWrapper`, of equal arguments around equal spaces, are run together, and
    chains that the compiled kernel knows (:mod:`stkzoo.views.compile`) in one pass. All
    other chains run agent by agent; a wrapper with a ``step`` of its own works too, and
    waits in a small thread while the race moves. Observations that are handed out share no
    memory with the batch or with earlier results.

    Attributes:
        observation_spaces: each agent's observation space, after its wrappers.
        action_spaces: each agent's action space, before its wrappers.
        paths_used: how many track segments the chains look at; ``None`` is all.
        sees_ground: whether an agent's base observations tell of the ground.

    Args:
        observation_spaces: each agent's base observation space.
        action_spaces: each agent's base action space, the same ``Dict`` for all.
        factories: wraps an agent's environment; agents that are left out, or ``None``,
            have no wrappers.
        ignored: agents that somebody else drives. They may leave out their action; it is
            not looked at, and their base action is all zeros.
        columns: the keys of the base actions in the order in which :meth:`decode` gives
            them; by default the order of their space.

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
        columns: Sequence[str] | None = None,
    ) -> None:
        self._columns = tuple(_shared_space(action_spaces) if columns is None else columns)
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
        self.sees_ground = any(map(shows_ground, observation_spaces.values()))
        self._ignored = frozenset(ignored)
        self._plan_key: tuple[str, ...] | None = None
        self._plan: list[_Group] = []
        self._fused: dict[Hashable, tuple[Any, Any]] = {}
        self._targets_of: tuple[Any, Any, list[npt.NDArray[np.intp]]] = None, None, []
        self.observation_spaces = {a: chain.observation_space for a, chain in self._chains.items()}
        self.action_spaces = {a: chain.action_space for a, chain in self._chains.items()}

    def decode(
        self,
        actions: Mapping[str, Any],
        agents: Sequence[str],
        rows: npt.NDArray[np.intp] | None = None,
        num_rows: int | None = None,
    ) -> npt.NDArray[np.float32]:
        """The base actions for the agents' actions.

        All actions are checked before any wrapper sees one. Actions of others than
        ``agents`` are not looked at.

        Args:
            actions: actions by agent, in each agent's ``action_spaces``.
            agents: the agents that act.
            rows: in which row of the result each agent's base action goes; by default in
                the agents' order. Those of agents that are ignored go nowhere.
            num_rows: how many rows there are, by default as many as agents; those of nobody
                are zeros.

        Returns:
            ``(num_rows, n)`` float32, with the columns that the constructor was told of.

        Raises:
            ActionError: an action is missing or not in its space.
            AgentException: a wrapper failed.
        """
        groups = self._groups(agents)
        targets = self._targets(groups, rows)
        count = len(agents) if num_rows is None else num_rows
        controls = np.zeros((count, len(self._columns)), np.float32)
        unread = [
            (group, target)
            for group, target in zip(groups, targets, strict=True)
            if not _is_read(group, actions, target, controls)
        ]
        if unread:
            self._require_actions(actions, agents)
            self._decode_unread(unread, actions, controls)
        return controls

    def _decode_unread(
        self,
        unread: Sequence[tuple[_Group, npt.NDArray[np.intp]]],
        actions: Mapping[str, Any],
        controls: npt.NDArray[np.float32],
    ) -> None:
        checked = [self._read(group, actions) for group, _ in unread]
        try:
            for (group, target), batch in zip(unread, checked, strict=True):
                if batch is not None:
                    self._decode_group(group, batch, target, controls)
        except BaseException:
            self._abandon()
            raise

    def reset(
        self,
        agents: Sequence[str],
        sight: Sight,
        infos: Mapping[str, dict[str, Any]],
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Resets all wrappers with the race's first observations.

        Args:
            agents: the agents, in the order of the sight's rows.
            sight: what they see.
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
            for agent, observation in zip(group.agents, self._seen(group, sight), strict=True):
                info = dict(infos[agent])
                if not group.chain.is_batched:
                    own_seed = None if seed is None else seed + self._numbers[agent]
                    own_options = None if options is None else dict(options)
                    observation, info = group.chain.reset(
                        observation, info, seed=own_seed, options=own_options
                    )
                observations[agent], new_infos[agent] = observation, info
        return _ordered(observations, agents), _ordered(new_infos, agents)

    def views(self, agents: Sequence[str]) -> list[tuple[Any, npt.NDArray[np.intp]]]:
        """The kernel's views, each with the numbers of the agents that it shows all to."""
        if kernel is None:
            return []
        return [(g.view, g.rows) for g in self._groups(agents) if isinstance(g.view, kernel.View)]

    def step(self, agents: Sequence[str], sight: Sight, parts: StepParts) -> StepParts:
        """The agents' views of one step; call it once after each :meth:`decode`.

        Args:
            agents: the agents that acted, in the order of the sight's rows.
            sight: what they see.
            parts: what happened to them, by agent in the same order; it becomes the
                result. Observations other than ``None`` are there already, through
                :meth:`views`.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent.

        Raises:
            AgentException: a wrapper failed.
        """
        observations = parts[0]
        try:
            for group in self._groups(agents):
                if observations[group.agents[0]] is not None:
                    continue
                observations.update(zip(group.agents, self._seen(group, sight), strict=True))
                if not group.chain.is_batched:
                    (agent,) = group.agents
                    own = group.chain.finish_step(_part(parts, agent))
                    for part, value in zip(cast(_Dicts, parts), own, strict=True):
                        part[agent] = value
        except BaseException:
            self._abandon()
            raise
        return parts

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
            self._plan = [self._group(key, identity, rows) for identity, rows in members.items()]
            self._plan_key = key
        return self._plan

    def _group(self, agents: tuple[str, ...], identity: Hashable, rows: list[int]) -> _Group:
        own = tuple(agents[row] for row in rows)
        chain = self._chains[own[0]]
        if identity not in self._fused:
            self._fused[identity] = chain.fused_view(), chain.fused_controls(self._columns)
        view, controls = self._fused[identity]
        return _Group(
            chain=chain,
            agents=own,
            rows=np.array(rows, np.intp),
            is_all=own == agents,
            has_ignored=not self._ignored.isdisjoint(own),
            view=view,
            controls=controls,
        )

    def __getstate__(self) -> dict[str, Any]:
        # What the kernel has made of the chains is made again when it is needed.
        fresh: dict[str, Any] = {
            "_plan_key": None,
            "_plan": [],
            "_fused": {},
            "_targets_of": (None, None, []),
        }
        return {**self.__dict__, **fresh}

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

    def _targets(
        self, groups: Sequence[_Group], rows: npt.NDArray[np.intp] | None
    ) -> list[npt.NDArray[np.intp]]:
        """The rows of the controls that belong to each group's agents."""
        if rows is None:
            return [group.rows for group in groups]
        if self._targets_of[0] is not groups or self._targets_of[1] is not rows:
            self._targets_of = groups, rows, [rows[group.rows] for group in groups]
        return self._targets_of[2]

    def _decode_group(
        self,
        group: _Group,
        batch: Any,
        target: npt.NDArray[np.intp],
        controls: npt.NDArray[np.float32],
    ) -> None:
        chain = group.chain
        if chain.is_batched:
            with agent_failures(group.agents[0], "change its action"):
                base = chain.act(batch)
        else:
            base = chain.begin_base_step(split(chain.action_space, batch)[0])
        acting = [agent not in self._ignored for agent in group.agents]
        for column, key in enumerate(self._columns):
            controls[target[acting], column] = np.reshape(base[key], -1)[acting]

    def _seen(self, group: _Group, sight: Sight) -> list[Any]:
        """What a group's agents see: the final view of a batched group, else the base view."""
        chain = group.chain
        if group.view is not None:
            seen = sight.through(group.view, group.rows)
            if seen is not None:
                return seen
        space = chain.base_observation_space
        batch = take(space, sight.batch(), slice(None) if group.is_all else group.rows)
        if chain.is_batched:
            space = chain.observation_space
            with agent_failures(group.agents[0], "change its observation"):
                batch = chain.observe(batch)
        return split(space, batch)

    def _abandon(self) -> None:
        for chain in self._chains.values():
            chain.abandon()


def _part(result: StepParts, agent: str) -> AgentStep:
    """One agent's part of a step's result, its info a copy."""
    observations, rewards, terminations, truncations, infos = result
    info = dict(infos[agent])
    return observations[agent], rewards[agent], terminations[agent], truncations[agent], info


def _is_read(
    group: _Group,
    actions: Mapping[str, Any],
    target: npt.NDArray[np.intp],
    controls: npt.NDArray[np.float32],
) -> bool:
    """Whether the kernel could read a group's actions, and has."""
    if group.controls is None or group.has_ignored:
        return False
    return bool(group.controls.read(actions, group.agents, target, controls))


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


def _ordered(values: dict[str, Any], agents: Sequence[str]) -> dict[str, Any]:
    return {agent: values[agent] for agent in agents}
