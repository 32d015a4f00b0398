"""The chains of all agents of a race, in which equal views are made together."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.errors import ActionError, AgentException, shortened
from stkzoo.kernel import ActionReader, CarController
from stkzoo.views.agent_chain import WrapperMemory
from stkzoo.views.plan import ObservationSource, Observer, ViewPlan
from stkzoo.views.walker import ChainWalker, Factories, StepParts

IntArray = npt.NDArray[np.intp]
FloatArray = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class _Group:
    """Agents with equal plans, among the agents of one call.

    Attributes:
        agents: all of them.
        rows: their places among the call's agents.
        observer: makes what they see.
        reader: reads what they do.
        acting: those whose action it reads as it comes.
        acting_rows: their places.
        walking: those whose action it reads after wrappers that the kernel does not do.
        walking_rows: their places.
        car: turns actions in physical units into controls, if they are in such units.
        numbers: of all agents of the group, among all agents of the race.
    """

    agents: tuple[str, ...]
    rows: IntArray
    observer: Observer
    reader: ActionReader
    acting: tuple[str, ...]
    acting_rows: IntArray
    walking: tuple[str, ...]
    walking_rows: IntArray
    car: CarController | None
    numbers: IntArray


@dataclass(frozen=True, slots=True)
class _Roster:
    """The agents of one call, sorted by what there is to do for them.

    Attributes:
        agents: all of them.
        groups: those with equal plans together.
        walked: those with wrappers that the kernel does not do.
    """

    agents: tuple[str, ...]
    groups: tuple[_Group, ...]
    walked: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ChainsMemory:
    """What the wrappers of all agents remember at one moment.

    Attributes:
        wrappers: of each agent those that run by themselves.
        cars: of each agent what the kernel remembers for those that act in physical units.
    """

    wrappers: Mapping[str, WrapperMemory]
    cars: npt.NDArray[np.float64]


class AgentChains:
    """Decodes the actions of all agents and makes each agent's view of what follows.

    The innermost wrappers of a chain that the kernel can do (:mod:`stkzoo.views.plan`) are left
    to it, in one pass for all agents with equal ones. The wrappers outside of these run agent by
    agent; a wrapper with a ``step`` of its own works too, and waits in a small thread while the
    race moves. Observations that are handed out share no memory with earlier results.

    Attributes:
        observation_spaces: each agent's observation space, after its wrappers.
        action_spaces: each agent's action space, before its wrappers.

    Args:
        observation_spaces: each agent's space in the ``full`` view.
        action_spaces: each agent's base action space, the same ``Dict`` for all.
        factories: the agents' views; those that are left out, or ``None``, have no wrappers.
        ignored: agents that the game's AI drives. They may leave out their action; it is
            not looked at, and their base action is all zeros.
        columns: the keys of the base actions in the order in which :meth:`decode` gives
            them.

    Raises:
        AgentException: a function raised, or returned no wrapper of what it was given.
        ConfigError: a view is for no agent, unknown, or refuses its environment or options.
    """

    def __init__(
        self,
        observation_spaces: Mapping[str, spaces.Dict],
        action_spaces: Mapping[str, spaces.Dict],
        factories: Factories,
        ignored: Collection[str],
        columns: Sequence[str],
    ) -> None:
        self._columns = tuple(columns)
        self._walker = ChainWalker(observation_spaces, action_spaces, factories)
        self._chains = self._walker.chains
        self._plans = {agent: chain.compile(columns) for agent, chain in self._chains.items()}
        self._identities = {agent: plan.identity() for agent, plan in self._plans.items()}
        self._numbers = {agent: number for number, agent in enumerate(self._chains)}
        self._ignored = frozenset(ignored)
        self._made: dict[Hashable, tuple[Observer, ActionReader, CarController | None]] = {}
        #: Wheel angle [rad], speed still owed [m/s] and length of a step [s] of each agent that
        #: acts in physical units (:class:`~stkzoo.kernel.reference.car_controller.CarController`).
        self._cars = np.zeros((len(self._chains), 3))
        self._present: _Roster | None = None
        self.observation_spaces = self._walker.observation_spaces
        self.action_spaces = self._walker.action_spaces

    def decode(
        self,
        actions: Mapping[str, Any],
        agents: Sequence[str],
        rows: IntArray | None = None,
        num_rows: int | None = None,
        source: ObservationSource | None = None,
    ) -> FloatArray:
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
            source: the race at this moment, for agents that act in physical units.

        Returns:
            ``(num_rows, n)`` float32, with the columns that the constructor was given.

        Raises:
            ActionError: an action is missing or not in its space.
            AgentException: a wrapper failed.
        """
        roster = self._roster(agents)
        rows = np.arange(len(agents)) if rows is None else rows
        count = len(agents) if num_rows is None else num_rows
        controls = np.zeros((count, len(self._columns)), np.float32)
        unread = [
            group
            for group in roster.groups
            if not group.reader.read(actions, group.acting, rows[group.acting_rows], controls)
        ]
        if unread or roster.walked:
            self._require_actions(actions, agents)
            for group in unread:
                usual = {a: self._chains[a].read_action(actions[a]) for a in group.acting}
                group.reader.read(usual, group.acting, rows[group.acting_rows], controls)
            asked = {a: actions[a] for a in roster.walked if a not in self._ignored}
            base = self._walker.begin_step(asked, roster.walked)
            for group in roster.groups:
                group.reader.read(base, group.walking, rows[group.walking_rows], controls)
        for group in roster.groups:
            if group.car is not None and source is not None:
                karts, data = source.karts(agents)[group.rows], source.snapshot.data
                own = rows[group.rows]
                group.car.drive(controls, own, data, karts, self._cars, group.numbers)
        return controls

    def observe(self, agents: Sequence[str], source: ObservationSource) -> dict[str, Any]:
        """What some agents see, before the wrappers that run agent by agent.

        Args:
            agents: the agents.
            source: the race at this moment.
        """
        roster, karts = self._roster(agents), source.karts(agents)
        if len(roster.groups) == 1:
            (group,) = roster.groups
            return dict(zip(group.agents, group.observer.observe(source, karts), strict=True))
        observations: dict[str, Any] = dict.fromkeys(agents)
        for group in roster.groups:
            seen = group.observer.observe(source, karts[group.rows])
            observations.update(zip(group.agents, seen, strict=True))
        return observations

    def reset(
        self,
        agents: Sequence[str],
        source: ObservationSource,
        infos: Mapping[str, dict[str, Any]],
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Resets all wrappers with the race's first observations.

        Args:
            agents: the agents.
            source: the race at its first moment.
            infos: info by agent.
            seed: seeds the wrappers' ``np_random``: agent number ``n`` with ``seed + n``.
            options: handed to every wrapper's ``reset``.

        Returns:
            Observations and infos by agent.

        Raises:
            AgentException: a wrapper failed.
        """
        self._walker.abandon()
        self._reset_cars(options or {})
        observations = self.observe(agents, source)
        new_infos = {agent: dict(infos[agent]) for agent in agents}
        walked = self._roster(agents).walked
        self._walker.reset(walked, observations, new_infos, seed, options)
        return observations, new_infos

    def finish(self, agents: Sequence[str], parts: StepParts) -> None:
        """Runs the second half of the wrappers' steps; call it once after each :meth:`decode`.

        Args:
            agents: the agents that acted.
            parts: what happened to them, with what :meth:`observe` gave; the wrappers' answers
                take its place.

        Raises:
            AgentException: a wrapper failed.
        """
        walked = self._roster(agents).walked
        if walked:
            self._walker.finish_step(walked, parts)

    def memory(self) -> ChainsMemory:
        """What the agents' wrappers remember between steps, as a value.

        Raises:
            AgentException: a wrapper holds something that cannot be copied.
        """
        wrappers = {agent: chain.memory() for agent, chain in self._chains.items()}
        return ChainsMemory(wrappers, self._cars.copy())

    def check_memory(self, memory: ChainsMemory) -> None:
        """Checks that :meth:`recall` can take a memory.

        Raises:
            AgentException: an agent's wrappers are others.
        """
        for number, (agent, chain) in enumerate(self._chains.items()):
            chain.check_memory(memory.wrappers[agent])
            has_car = self._plans[agent].car is not None
            if has_car != (memory.cars[number, 2] > 0):
                raise AgentException(
                    f"the wrappers of agent {agent!r} failed to take over a saved state: "
                    f"they act {'' if has_car else 'not '}in physical units, unlike the state's",
                    agent,
                )

    def recall(self, memory: ChainsMemory) -> None:
        """Makes the wrappers remember what :meth:`memory` gave, here or in equal chains.

        Args:
            memory: one that :meth:`check_memory` takes.

        Raises:
            AgentException: a wrapper's memory cannot be copied.
        """
        for agent, chain in self._chains.items():
            chain.recall(memory.wrappers[agent])
        self._cars[:] = memory.cars

    def close(self) -> None:
        """Closes all wrappers."""
        self._walker.close()

    def _reset_cars(self, options: Mapping[str, Any]) -> None:
        self._cars[:] = 0.0
        for number, plan in enumerate(self._plans.values()):
            if plan.car is not None:
                self._cars[number, 2] = options.get("step_size", plan.car.step_size)

    def _roster(self, agents: Sequence[str]) -> _Roster:
        key = tuple(agents)
        if self._present is None or key != self._present.agents:
            self._present = self._new_roster(key)
        return self._present

    def _new_roster(self, agents: tuple[str, ...]) -> _Roster:
        members: dict[Hashable, list[int]] = {}
        for row, agent in enumerate(agents):
            members.setdefault(self._identities[agent], []).append(row)
        groups = tuple(self._group(agents, rows) for rows in members.values())
        walked = tuple(agent for agent in agents if not self._chains[agent].is_empty)
        return _Roster(agents, groups, walked)

    def _group(self, agents: tuple[str, ...], rows: list[int]) -> _Group:
        own = tuple(agents[row] for row in rows)
        identity, plan = self._identities[own[0]], self._plans[own[0]]
        if identity not in self._made:
            observer = plan.observer or _RecordsObserver(plan)
            made = observer, plan.new_reader(), plan.new_controller()
            self._made[identity] = made
        observer, reader, car = self._made[identity]
        players = [row for row in rows if agents[row] not in self._ignored]
        acting = [row for row in players if self._chains[agents[row]].is_empty]
        walking = [row for row in players if row not in acting]
        return _Group(
            agents=own,
            rows=np.array(rows, np.intp),
            observer=observer,
            reader=reader,
            acting=tuple(agents[row] for row in acting),
            acting_rows=np.array(acting, np.intp),
            walking=tuple(agents[row] for row in walking),
            walking_rows=np.array(walking, np.intp),
            car=car,
            numbers=np.array([self._numbers[agent] for agent in own], np.intp),
        )

    def __getstate__(self) -> dict[str, Any]:
        # What the kernel has made of the plans is made again when it is needed.
        return {**self.__dict__, "_made": {}, "_present": None}

    def _require_actions(self, actions: Mapping[str, Any], agents: Sequence[str]) -> None:
        if not isinstance(actions, Mapping):
            raise ActionError(
                f"the actions have to be a dict by agent: {', '.join(agents)}; found "
                f"{shortened(actions, 200)}",
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


class _RecordsObserver:
    """Makes observations straight from the game's records, and of the ground if they tell of it."""

    def __init__(self, plan: ViewPlan) -> None:
        self._observer = plan.new_observer()
        self._names = plan.names if plan.sees_ground else ()

    def observe(self, source: ObservationSource, karts: IntArray) -> list[Any]:
        """See :class:`Observer`."""
        observations = self._observer.observe(*source.course, source.snapshot.data, karts)
        if not self._names:
            return observations
        ahead = source.ground_ahead(karts)
        for row, own in enumerate(observations):
            seen = own | {key: values[row] for key, values in ahead.items()}
            observations[row] = {name: seen[name] for name in self._names}
        return observations
