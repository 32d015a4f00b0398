"""The wrapper chains of all agents of a race; agents with equal views are processed together."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.agent_names import actions_by_agent
from stkzoo.engine.snapshot import CONTROLS
from stkzoo.errors import AgentException
from stkzoo.kernel import ActionReader, CarController, new_batch, split_batch
from stkzoo.mdp.spaces import STANDING_SIZE, as_actions, kart_action_space
from stkzoo.views.agent_chain import WrapperMemory
from stkzoo.views.plan import (
    ObservationSource,
    RowObserver,
    Seats,
    ViewPlan,
    form_of,
    is_extra,
    write_rows,
)
from stkzoo.views.registry import ViewFactory, base_space
from stkzoo.views.walker import ChainWalker, StepParts

if TYPE_CHECKING:
    from stkzoo.wrappers.camera import Camera

IntArray = npt.NDArray[np.intp]
FloatArray = npt.NDArray[np.float32]


class RecordsObserver:
    """Makes observations from the game's records, the ground and the actions of the game's AI.

    Args:
        plan: plan of the view.
    """

    def __init__(self, plan: ViewPlan) -> None:
        self._kernel, self._names = plan.new_observer(), tuple(plan.parts)
        self._extras = tuple(filter(is_extra, self._names))

    def observe(self, source: ObservationSource, karts: IntArray) -> list[Any]:
        """Returns the karts' observations in a view with lists of varying length."""
        seen = self._kernel.observe(*source.course, source.snapshot.data, karts)
        if not self._extras:
            return seen
        more = split_batch(self._values(source, karts), tuple(range(len(karts))))
        both = [entries | more[row] for row, entries in enumerate(seen)]
        return [{name: entries[name] for name in self._names} for entries in both]

    def observe_into(
        self, source: ObservationSource, karts: IntArray, rows: IntArray, batch: Any
    ) -> None:
        """See :class:`RowObserver`; for views of a fixed size."""
        self._kernel.observe_into(*source.course, source.snapshot.data, karts, rows, batch)
        if self._extras:
            write_rows(batch, rows, self._values(source, karts))

    def _values(self, source: ObservationSource, karts: IntArray) -> dict[str, Any]:
        """Returns a batch of the entries that are not in the records."""
        values: dict[str, Any] = {}
        if "action" in self._extras:
            values["action"] = dict(
                sorted(as_actions(source.snapshot.karts["control"][karts]).items())
            )
        if "standing" in self._extras:
            values["standing"] = np.empty((len(karts), STANDING_SIZE), np.float32)
            source.standing_into(karts, np.arange(len(karts)), values["standing"], 0)
        if len(self._extras) > len(values):
            values |= source.ground_ahead(karts)
        return values


class _PlanKernel:
    """What the kernel does for all agents with equal plans.

    Args:
        plan: the plan.
        space: space of the observations that it makes.

    Attributes:
        reader: converts actions to controls.
        rows: makes observations of a fixed size.
        car: converts actions in physical units to controls, if the plan has such actions.
    """

    def __init__(self, plan: ViewPlan, space: spaces.Space[Any]) -> None:
        self.reader: ActionReader = plan.new_reader()
        self.car: CarController | None = plan.new_controller()
        self._records = RecordsObserver(plan)
        self.rows: RowObserver = plan.observer or self._records
        self._form = form_of(space) if plan.has_rows else None

    def observe(self, source: ObservationSource, seats: Seats) -> dict[str, Any]:
        """Returns the observations of some agents, which share no memory with others."""
        if self._form is None:
            return dict(zip(seats.agents, self._records.observe(source, seats.karts), strict=True))
        batch = new_batch(self._form, len(seats.agents))
        self.rows.observe_into(source, seats.karts, seats.order, batch)
        return split_batch(batch, seats.agents)


@dataclass(frozen=True, slots=True)
class _Group:
    """Agents with equal plans whose actions take the same way.

    Attributes:
        kernel: makes their observations and reads their actions.
        seats: where they sit.
        places: their places among the seats of all agents.
        numbers: their rows in the memory of the car controllers.
        is_walked: whether their actions pass through Python wrappers first.
    """

    kernel: _PlanKernel
    seats: Seats
    places: IntArray
    numbers: IntArray
    is_walked: bool


@dataclass(frozen=True, slots=True)
class _Roster:
    """Agents in their seats, grouped by the work to do.

    Attributes:
        seats: the seats.
        groups: all agents.
        acting: those that the game's AI does not drive.
        walked: all agents with Python wrappers.
    """

    seats: Seats
    groups: tuple[_Group, ...]
    acting: tuple[_Group, ...]
    walked: tuple[str, ...]


@dataclass(slots=True)
class CheckedActions:
    """Valid actions of one step, before any wrapper has run.

    Attributes:
        roster: the agents that act.
        controls: base actions of the agents whose wrappers all run in the kernel, but actions in
            physical units as they came.
        walked: actions of the agents with Python wrappers.
    """

    roster: _Roster
    controls: FloatArray
    walked: Mapping[str, Any]


#: State of the wrappers at one moment, by agent: of those in Python, and of the kernel's car
#: controller.
ChainsMemory: TypeAlias = Mapping[str, tuple[WrapperMemory, npt.NDArray[np.float64]]]


class AgentChains:
    """Decodes the actions of all agents and makes their observations.

    The kernel runs the innermost wrappers of a chain that it implements (:mod:`stkzoo.views.plan`),
    in one pass for all agents with equal plans. The other wrappers run agent by agent. A wrapper
    with its own ``step`` waits in a thread while the race advances. Returned observations share no
    memory with earlier results.

    Attributes:
        observation_spaces: each agent's observation space, after its wrappers.
        action_spaces: each agent's action space, before its wrappers.
        is_compiled: whether the kernel runs all wrappers.
        has_rows: whether it does and observations have a fixed size, for :meth:`observe_into`.

    Args:
        views: view of each agent.
        ignored: agents that the game's AI drives. Their actions are optional and ignored, and their
            controls are zeros.
        cameras: cameras by agent, if the race can render.

    Raises:
        AgentException: a view failed, or did not return a wrapper of its argument.
        ConfigError: a view rejects its environment or options.
    """

    def __init__(
        self,
        views: Mapping[str, ViewFactory],
        ignored: Collection[str] = (),
        cameras: Mapping[str, Camera] | None = None,
    ) -> None:
        seen = {agent: base_space(view, agent in ignored) for agent, view in views.items()}
        acted = {agent: kart_action_space() for agent in views}
        self._walker = ChainWalker(seen, acted, views, cameras)
        self._chains = self._walker.chains
        self._plans = {agent: chain.compile() for agent, chain in self._chains.items()}
        self._numbers = {agent: number for number, agent in enumerate(self._chains)}
        self._ignored = frozenset(ignored)
        kernels: dict[Hashable, _PlanKernel] = {}  # by identity, shared by agents
        self._kernels: dict[str, _PlanKernel] = {}
        for agent, plan in self._plans.items():
            identity, space = plan.identity(), self._chains[agent].base_observation_space
            self._kernels[agent] = kernels.get(identity) or _PlanKernel(plan, space)
            kernels[identity] = self._kernels[agent]
        #: Wheel angle [rad], remaining speed change [m/s] and step length [s] of each agent with
        #: actions in physical units
        #: (:class:`~stkzoo.kernel.CarController`).
        self._cars = np.zeros((len(self._chains), 3))
        self._has_car = np.array([plan.car is not None for plan in self._plans.values()], np.bool_)
        self._latest_roster: _Roster | None = None
        self.observation_spaces = self._walker.observation_spaces
        self.action_spaces = self._walker.action_spaces
        self.is_compiled = all(chain.is_empty for chain in self._chains.values())
        self.has_rows = self.is_compiled and all(plan.has_rows for plan in self._plans.values())

    def check(self, actions: Mapping[str, Any], seats: Seats) -> CheckedActions:
        """Checks the agents' actions and changes nothing; :meth:`convert` converts them.

        Actions of agents without a seat are ignored.

        Args:
            actions: actions by agent, in each agent's ``action_spaces``.
            seats: the agents that act. Base actions of ignored agents are dropped.

        Raises:
            ActionError: an action is missing or not in its space.
        """
        roster = self._roster(seats)
        controls = np.zeros((seats.num_rows, len(CONTROLS)), np.float32)
        walked: Mapping[str, Any] = {}
        unread = [
            group
            for group in roster.acting
            if not group.is_walked
            and not group.kernel.reader.read(
                actions, group.seats.agents, group.seats.rows, controls
            )
        ]
        if unread or roster.walked:
            actions = actions_by_agent(actions, seats.agents, self._ignored)
            for group in unread:
                agents, rows = group.seats.agents, group.seats.rows
                usual = {a: self._chains[a].read_action(actions[a]) for a in agents}
                group.kernel.reader.read(usual, agents, rows, controls)
            asked = [agent for agent in roster.walked if agent not in self._ignored]
            walked = self._walker.read_actions(actions, asked)
        return CheckedActions(roster, controls, walked)

    def check_batch(
        self, batch: Any, slots: IntArray, num_slots: int, seats: Seats
    ) -> CheckedActions | None:
        """Does the same as :meth:`check` for a batch of actions, if no wrapper runs in Python.

        Args:
            batch: an array with one row per slot, or a dict of such arrays.
            slots: slot of each agent.
            num_slots: number of slots in the batch.
            seats: see :meth:`check`.

        Returns:
            The actions. ``None`` if an action is invalid or in an unusual form, which
                :meth:`check` converts or rejects.
        """
        roster = self._roster(seats)
        controls = np.zeros((seats.num_rows, len(CONTROLS)), np.float32)
        is_read = not roster.walked and all(
            group.kernel.reader.read(
                batch, slots[group.places], group.seats.rows, controls, num_slots
            )
            for group in roster.acting
        )
        return CheckedActions(roster, controls, {}) if is_read else None

    def convert(self, checked: CheckedActions, source: ObservationSource) -> FloatArray:
        """Runs the wrappers of the agents that act, and returns their base actions.

        Args:
            checked: actions from :meth:`check` or :meth:`check_batch`; used up by this call.
            source: the race at this moment.

        Returns:
            Controls ``(seats.num_rows, 7)`` float32. Rows without an agent are zeros.

        Raises:
            ActionError: a wrapper returned an action outside its agent's base space.
            AgentException: a wrapper failed.
        """
        roster, controls = checked.roster, checked.controls
        base = self._walker.begin_step(checked.walked, roster.walked) if roster.walked else {}
        for group in roster.acting:
            car, seats = group.kernel.car, group.seats
            if group.is_walked:
                group.kernel.reader.read(base, seats.agents, seats.rows, controls)
            if car is not None:  # the controls are in physical units
                data, numbers = source.snapshot.data, group.numbers
                car.drive(controls, seats.rows, data, seats.karts, self._cars, numbers)
        return controls

    def observe(self, seats: Seats, source: ObservationSource) -> dict[str, Any]:
        """Returns the agents' observations before the Python wrappers.

        Args:
            seats: the agents.
            source: the race at this moment.
        """
        groups = self._roster(seats).groups
        if len(groups) == 1:  # the agents are in order already
            return groups[0].kernel.observe(source, groups[0].seats)
        observations: dict[str, Any] = dict.fromkeys(seats.agents)
        for group in groups:
            observations |= group.kernel.observe(source, group.seats)
        return observations

    def observe_into(
        self, seats: Seats, source: ObservationSource, slots: IntArray, batch: Any
    ) -> None:
        """Writes the agents' observations into rows of a batch; see :attr:`has_rows`.

        Args:
            seats: the agents.
            source: the race at this moment.
            slots: slot of each agent.
            batch: an array with one row per slot, or a dict of arrays and lists by entry.
        """
        for group in self._roster(seats).groups:
            group.kernel.rows.observe_into(source, group.seats.karts, slots[group.places], batch)

    def reset(
        self,
        seats: Seats,
        source: ObservationSource,
        infos: Mapping[str, dict[str, Any]],
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Resets all wrappers with the race's first observations.

        Args:
            seats: the agents.
            source: the race at its first moment.
            infos: infos by agent.
            seed: seed of the wrappers' ``np_random``: agent ``n`` gets ``seed + n``.
            options: passed to the ``reset`` of every wrapper, with the ``step_size`` of the race.

        Returns:
            Observations and infos by agent.

        Raises:
            AgentException: a wrapper failed.
        """
        self._walker.abandon()
        self._cars[:] = 0.0
        self._cars[self._has_car, 2] = source.step_size
        observations = self.observe(seats, source)
        new_infos = {agent: dict(infos[agent]) for agent in seats.agents}
        walked = self._roster(seats).walked
        options = {**(options or {}), "step_size": source.step_size}
        self._walker.reset(walked, observations, new_infos, seed, options)
        return observations, new_infos

    def finish(self, seats: Seats, parts: StepParts) -> None:
        """Runs the second half of the wrappers' steps, once after each :meth:`convert`.

        Args:
            seats: the agents that acted.
            parts: result of the step, with observations from :meth:`observe`; the wrapped results
                replace it in place.

        Raises:
            AgentException: a wrapper failed; the agents after this one have not finished the step.
        """
        walked = self._roster(seats).walked
        if walked:
            self._walker.finish_step(walked, parts)

    def memory(self) -> ChainsMemory:
        """Returns a copy of the state of all agents' wrappers.

        Raises:
            AgentException: a wrapper holds an object that cannot be copied.
        """
        chains = zip(self._chains.items(), self._cars.copy(), strict=True)
        return {agent: (chain.memory(), car) for (agent, chain), car in chains}

    def check_memory(self, memory: ChainsMemory) -> None:
        """Checks that :meth:`recall` accepts a memory.

        Raises:
            AgentException: an agent has other wrappers.
        """
        for (agent, chain), has_car in zip(self._chains.items(), self._has_car, strict=True):
            wrappers, car = memory[agent]
            here, there = (list(map(type, each)) for each in (chain.remembering(), wrappers.owners))
            if here != there or has_car != (car[2] > 0):
                raise AgentException(
                    f"agent {agent!r} has other wrappers than in the saved state; use an "
                    "environment with the same views",
                    agent,
                )

    def recall(self, memory: ChainsMemory) -> None:
        """Restores the wrappers' state from :meth:`memory` of these or equal chains.

        Args:
            memory: a memory that :meth:`check_memory` accepts. It may include more agents.

        Raises:
            AgentException: a wrapper's memory cannot be copied.
        """
        for (agent, chain), car in zip(self._chains.items(), self._cars, strict=True):
            wrappers, car[:] = memory[agent]
            chain.recall(wrappers)

    def close(self) -> None:
        """Closes all wrappers."""
        self._walker.close()

    def _roster(self, seats: Seats) -> _Roster:
        roster = self._latest_roster
        if roster is None or roster.seats is not seats:
            roster = self._latest_roster = self._new_roster(seats)
        return roster

    def _new_roster(self, seats: Seats) -> _Roster:
        places_of: dict[tuple[bool, bool, _PlanKernel], list[int]] = {}
        for place, agent in enumerate(seats.agents):
            way = agent in self._ignored, not self._chains[agent].is_empty, self._kernels[agent]
            places_of.setdefault(way, []).append(place)
        groups = {way: self._group(seats, places, *way[1:]) for way, places in places_of.items()}
        return _Roster(
            seats,
            groups=tuple(groups.values()),
            acting=tuple(group for (is_ignored, *_), group in groups.items() if not is_ignored),
            walked=tuple(agent for agent in seats.agents if not self._chains[agent].is_empty),
        )

    def _group(
        self, seats: Seats, places: Sequence[int], is_walked: bool, kernel: _PlanKernel
    ) -> _Group:
        at = np.array(places)
        group_seats = seats.at(at)
        numbers = np.array([self._numbers[agent] for agent in group_seats.agents], np.intp)
        return _Group(kernel, group_seats, at, numbers, is_walked)
