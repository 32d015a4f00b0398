"""One race from start to end: the state that the parallel environment keeps for it."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agent_names import agent_named, by_agent
from stkzoo.engine.ground import Ground, ground_of
from stkzoo.engine.race import RaceStart
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import CONTROLS, Snapshot
from stkzoo.engine.track import decode_track
from stkzoo.env.grid import RaceInfo
from stkzoo.env.options import RaceOptions
from stkzoo.kernel import StepScorer, observe_standing, split_batch
from stkzoo.mdp.events import EVENTS, STREAKS, RaceEvents
from stkzoo.mdp.rewards import KernelTerm, Reward, RewardOver, as_reward
from stkzoo.mdp.state import race_state
from stkzoo.mdp.transition import Transition
from stkzoo.names import EndReason
from stkzoo.views.plan import Seats
from stkzoo.wrappers.racing import ground_observer

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]

#: Rewards, terminations and truncations, each an array with one number per slot.
EndArrays = tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.bool_]]

_ENDED_BY = "ended_by"
#: Keys of infos whose values are whole numbers, in order. The kernel writes all but the last.
WHOLE_INFOS = ("position", "lap", "episode/length", _ENDED_BY)
#: The reason for an end that each state of karts causes.
_REASONS = tuple(EndReason[name.upper()] for name in STREAKS)


class InfoTable:
    """Infos of slots, with the same keys for each.

    Args:
        keys: the keys, in order.
        count: number of slots, S.

    Attributes:
        columns: ``(S,)`` values of each key: int64 for ranks, laps, lengths and reasons, else
            float64.
        has: ``(S,)`` bool, slots with an info.
        arrays: the rows that the kernel writes: ``(3, S)`` int64 and ``(N, S)`` float64.
    """

    def __init__(self, keys: Sequence[str], count: int) -> None:
        wholes = np.zeros((len(WHOLE_INFOS), count), np.int64)
        numbers = np.zeros((sum(key not in WHOLE_INFOS for key in keys), count))
        self.has = np.zeros(count, np.bool_)
        self.arrays = wholes[:-1], numbers
        whole_rows, number_rows = iter(wholes), iter(numbers)
        self.columns: dict[str, npt.NDArray[Any]] = {
            key: next(whole_rows if key in WHOLE_INFOS else number_rows) for key in keys
        }


def rewards_of_agents(choice: object, agents: Sequence[str]) -> dict[str, Reward]:
    """Returns each agent's reward; :mod:`stkzoo.mdp.rewards` lists the choices.

    Raises:
        ConfigError: the choice is invalid.
    """
    default = "race"
    if isinstance(choice, RewardOver):
        default, choice = choice.default, choice.choice
    choices = (Mapping, Reward)
    if isinstance(choice, Mapping) and any(
        not isinstance(name, str) or agent_named(name, agents) or isinstance(value, choices)
        for name, value in choice.items()
    ):
        chosen = by_agent(choice, agents)
        return {agent: as_reward(chosen.get(agent), default) for agent in agents}
    return dict.fromkeys(agents, as_reward(choice, default))


class Episode:
    """A running race, and the source of its agents' observations.

    Args:
        options: options of this race.
        setup: setup of the race in the engine.
        kart_indices: karts of the agents, followed by those of the opponents.
        start: result of starting the race in the engine.
        rewards: reward of each agent, in agent order.
        root: folder of the game's data.

    Attributes:
        setup: setup of the race in the engine.
        race: names of the race and its karts.
        track_map: map of the track.
        course: track graph, number of segments in observations, and kart models.
        snapshot: current snapshot.
        step_size: game time of one step [s].
        num_players: number of karts for which the engine expects controls.
        info_keys: keys of every info, in order.
        ends: arrays for the rewards, terminations and truncations of all agents, for reuse.
    """

    def __init__(
        self,
        options: RaceOptions,
        setup: RaceSetup,
        kart_indices: tuple[int, ...],
        start: RaceStart,
        rewards: Mapping[str, Reward],
        root: Path,
    ) -> None:
        self.setup, self._root = setup, root
        self.race = RaceInfo(
            **{field.name: getattr(setup, field.name) for field in fields(setup)},
            kart_indices=kart_indices[: len(rewards)],
            kart_types=start.kart_types,
            opponent_indices=kart_indices[len(rewards) :],
        )
        self.track_map = decode_track(start.track)
        self.snapshot = start.snapshot
        self.step_size = setup.step_size
        self._number_of = {f"kart_{number}": number for number in range(len(kart_indices))}
        self._karts = np.array(kart_indices, np.intp)
        self._teams = np.array([kart.team for kart in setup.karts], np.intp)
        self._players = np.flatnonzero([not kart.is_bot for kart in setup.karts])
        self.num_players = len(self._players)
        self._race_length = self.track_map.length * setup.laps
        self._latest_seats: tuple[tuple[Sequence[str], Seats], ...] = ()
        self._past: Any = None  # (earlier history, latest controls), shared by copies
        self._start(options, rewards)

    def copy(self) -> Episode:
        """Returns an independent copy of the episode at this moment."""
        twin = copy.copy(self)
        changing = self._last, self._sums, self._owed, self._events, self._endings
        twin._last, twin._sums, twin._owed, twin._events, twin._endings = copy.deepcopy(changing)
        twin._make_scorer()
        return twin

    def restarted(self, options: RaceOptions, rewards: Mapping[str, Reward]) -> Episode:
        """Returns a new episode that starts at this moment of the race.

        Args:
            options: options of the new episode; only :data:`~stkzoo.env.options.OF_AN_EPISODE`
                apply.
            rewards: reward of each agent, in agent order.
        """
        twin = copy.copy(self)
        twin._start(options, rewards)
        return twin

    def seats(self, agents: Sequence[str]) -> Seats:
        """Returns where some agents sit: the same object as long as the agents are the same."""
        for asked, seats in self._latest_seats:
            if asked == agents:
                return seats
        numbers = np.array([self._number_of[agent] for agent in agents], np.intp)
        karts = self._karts[numbers]
        rows = np.searchsorted(self._players, karts)
        seats = Seats(tuple(agents), karts, rows, self.num_players, numbers)
        # Agents and opponents alternate; a list of the caller may change later.
        self._latest_seats = (agents[:], seats), *self._latest_seats[:1]
        return seats

    def remember(self, controls: npt.NDArray[np.float32]) -> None:
        """Appends the controls of a step, ``(P, 7)`` float32, to the history."""
        self._past = self._past, controls.tobytes()

    def past_controls(self) -> npt.NDArray[np.float32]:
        """Returns the controls of all steps since the start of the race, ``(T, P, 7)`` float32."""
        rows, past = [], self._past
        while past is not None:
            past, row = past
            rows.append(row)
        numbers = np.frombuffer(b"".join(reversed(rows)), np.float32)
        return np.array(numbers.reshape(len(rows), self.num_players, len(CONTROLS)))

    def advance(self, snapshot: Snapshot, seats: Seats, slots: IntArray, ends: EndArrays) -> None:
        """Advances to the moment after a step and writes the results of the agents that acted.

        Args:
            snapshot: snapshot after the step.
            seats: the agents that acted.
            slots: slot of each agent.
            ends: rewards, terminations and truncations of all slots; changed in place.
        """
        before, self.snapshot = self.snapshot, snapshot
        self._num_steps += 1
        is_over = self._max_cycles is not None and self._num_steps >= self._max_cycles
        self._prepare(before, snapshot)
        self._scorer.score_into(before.data, snapshot.data, is_over, seats.numbers, slots, *ends)
        if self._endings is not None and self._events is not None:
            seconds = self._events.seconds[seats.karts]
            self._endings.end(ends, slots, seats.numbers, snapshot, seconds)

    def infos(self, seats: Seats) -> dict[str, dict[str, Any]]:
        """Returns new infos of some agents: plain numbers under the same keys in every step.

        ``position`` is the rank, ``distance`` the distance driven [m], ``lap`` the number of
        completed laps, and ``finish_time`` the finish time [s] (0 before the finish).
        ``reward/<term>`` is the weighted term of this step and ``episode/reward/<term>`` its sum;
        ``episode/return`` is the return and ``episode/length`` the number of steps. With events,
        ``event/<name>`` and ``episode/event/<name>`` count the events of
        :data:`stkzoo.mdp.events.EVENTS`. With optional ends, ``ended_by`` is an
        :class:`~stkzoo.names.EndReason`.
        """
        self.infos_into(seats, seats.order, self._table)
        infos: dict[str, dict[str, Any]] = split_batch(self._table.columns, seats.agents)
        return infos

    def infos_into(self, seats: Seats, slots: IntArray, table: InfoTable) -> None:
        """Writes the infos of some agents into a table.

        Args:
            seats: the agents.
            slots: slot of each agent.
            table: a table with :attr:`info_keys`; changed in place.
        """
        length = self._num_steps
        self._scorer.infos_into(self.snapshot.data, length, seats.numbers, slots, *table.arrays)
        if self._endings is not None:
            table.columns[_ENDED_BY][slots] = self._endings.reasons[seats.numbers]

    def standing_into(self, karts: IntArray, rows: IntArray, batch: Any, column: int) -> None:
        """See :class:`~stkzoo.views.plan.ObservationSource`."""
        race = self._teams, self._race_length
        observe_standing(self.snapshot.data, *race, karts, rows, batch, column)

    @property
    def ground(self) -> Ground:
        """Ground and walls of the track."""
        race = self.race
        return ground_of(self.track_map, race.track, self._root, reverse=race.reverse)

    def ground_ahead(self, karts: IntArray) -> dict[str, npt.NDArray[Any]]:
        """Returns the observation entries of the ground ahead of some karts."""
        return ground_observer(self.track_map, self.ground).observe(self.snapshot, karts)

    def state(self) -> npt.NDArray[np.float32]:
        """Returns the state of the whole race as one vector (:mod:`stkzoo.mdp.state`)."""
        agents = self.race.kart_indices
        bots = [kart for kart in range(len(self.snapshot.karts)) if kart not in agents]
        order = np.array([*agents, *bots], np.intp)
        return race_state(self.snapshot, order, self.track_map.length, self.race.laps)

    def _start(self, options: RaceOptions, rewards: Mapping[str, Reward]) -> None:
        """Sets all counters to zero."""
        of_agent = [*rewards.values()]
        names = sorted({name for reward in of_agent for name in reward.terms})
        agents_with = {id(one): [each is one for each in of_agent] for one in of_agent}
        self._custom = [
            (reward, name, np.flatnonzero(agents_with[id(reward)]), names.index(name))
            for reward in {id(each): each for each in of_agent}.values()
            for name, term in reward.terms.items()
            if not isinstance(term, KernelTerm)
        ]
        self._rewards = tuple(_kernel_part(reward, names) for reward in of_agent)
        self._num_steps, self._max_cycles = 0, options.max_cycles
        endings = Endings(options, len(of_agent))
        self._endings = endings if endings.are_chosen else None
        self._shows_events, self._events = options.events, None
        if options.events or endings.are_chosen:
            self._events = RaceEvents(self.track_map, self.step_size, len(self.setup.karts))
        shown = EVENTS if options.events else ()
        columns = [*(f"reward/{name}" for name in names), *(f"event/{name}" for name in shown)]
        self._last = np.zeros((len(of_agent), len(columns)))
        self._sums, self._owed = np.zeros_like(self._last), np.zeros((len(of_agent), len(names)))
        self._limits = np.array([_limits(reward, names) for reward in of_agent]) * self.step_size
        self.info_keys = (
            *("position", "distance", "lap", "finish_time"),
            *columns,
            *(f"episode/{column}" for column in columns),
            *("episode/return", "episode/length"),
            *((_ENDED_BY,) if endings.are_chosen else ()),
        )
        self._make_scorer()
        num_nodes = self.track_map.num_nodes
        num_paths = min(num_nodes, options.max_paths or num_nodes)
        self.course = self.track_map.graph, num_paths, tuple(self.race.kart_types)

    @property
    def _shown_events(self) -> FloatArray | None:
        return self._events.counts if self._events is not None and self._shows_events else None

    def _prepare(self, before: Snapshot, after: Snapshot) -> None:
        """Counts events and writes the terms that are Python functions."""
        if self._events is not None:
            self._events.count(before, after)
        if not self._custom:
            return
        step = Transition(before, after, self._race_length, self._shown_events)
        for reward, name, agents, column in self._custom:
            self._last[agents, column] = reward.value(name, step)[self._karts[agents]]

    def _make_scorer(self) -> None:
        """Makes the scorer, which shares memory with other arrays, and arrays for its results."""
        count = len(self._rewards)
        karts = self._karts[:count]
        self._table = InfoTable(self.info_keys, count)
        terminations, truncations = np.zeros((2, count), np.bool_)
        self.ends: EndArrays = np.zeros(count), terminations, truncations
        shown = self._shown_events
        events = np.zeros(0) if shown is None else shown
        numbers = self._last, self._sums, self._owed, self._limits, self._race_length
        self._scorer = StepScorer(karts, *numbers, self._rewards, events)


def _kernel_part(
    reward: Reward, names: Sequence[str]
) -> tuple[tuple[str, ...], FloatArray, IntArray]:
    """Returns the built-in terms of a reward, their weights, and their columns among all terms."""
    terms = {name: term for name, term in reward.terms.items() if isinstance(term, KernelTerm)}
    weights = np.array([reward.weight_of(name) for name in terms], np.float64)
    columns = np.array([names.index(name) for name in terms], np.intp)
    return tuple(term.name for term in terms.values()), weights, columns


def _limits(reward: Reward, names: Sequence[str]) -> list[float]:
    """Returns the limit of each weighted term, infinite if it has none [1/s]."""
    limits = reward.limits
    return [limits.get(name, np.inf) * abs(reward.weight_of(name) or 1.0) for name in names]


class Endings:
    """Ends the episodes of agents that fail, and of all others after the first finish.

    An agent whose kart is stuck, drives in the wrong direction or is off the road for too long is
    *terminated*: it has failed, and its future reward is zero. Agents that are still racing after
    the first finish are *truncated*: the race would continue for them.

    Args:
        options: options of the episode.
        count: number of agents, A.

    Attributes:
        are_chosen: whether an option requests an end.
        reasons: ``(A,)`` int64, an :class:`~stkzoo.names.EndReason` for each agent.
    """

    def __init__(self, options: RaceOptions, count: int) -> None:
        limits = options.end_off_road, options.end_when_wrong_way, options.end_when_stuck
        self._limits = np.array([np.inf if limit is None else limit for limit in limits])
        self._steps_left = options.end_when_first_finishes
        self.are_chosen = limits != (None, None, None) or self._steps_left is not None
        self.reasons = np.zeros(count, np.int64)

    def end(
        self,
        ends: EndArrays,
        slots: npt.NDArray[np.intp],
        agents: IntArray,
        after: Snapshot,
        seconds: npt.NDArray[np.float64],
    ) -> None:
        """Adds the ends of a step.

        Args:
            ends: rewards, terminations and truncations of the step; changed in place.
            slots: ``(A,)`` slot of each agent.
            agents: ``(A,)`` numbers of the agents that were still racing.
            after: snapshot after the step.
            seconds: ``(A, 3)`` float64, how long each agent's kart has been in each state of
                :data:`stkzoo.mdp.events.STREAKS` [s].
        """
        _, terminations, truncations = ends
        is_cut = False
        if self._steps_left is not None and after.karts["has_finished_race"].any():
            self._steps_left -= 1
            is_cut = self._steps_left < 0
        fails = seconds > self._limits - 1e-6  # float sums are inexact
        for slot, agent, failed in zip(slots, agents, fails.tolist(), strict=True):
            if terminations[slot]:
                self.reasons[agent] = EndReason.FINISH
            elif any(failed):
                self.reasons[agent] = _REASONS[failed.index(True)]
                terminations[slot], truncations[slot] = True, False
            elif is_cut:
                self.reasons[agent], truncations[slot] = EndReason.FIRST_FINISH, True
            elif truncations[slot]:
                self.reasons[agent] = EndReason.MAX_CYCLES
