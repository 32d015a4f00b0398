"""One race from start to end: the state that the parallel environment keeps for it."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
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
from stkzoo.kernel import StepScorer, split_batch
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

#: Keys of infos whose values are whole numbers, in the order of their rows in the kernel's table.
WHOLE_INFOS = ("position", "lap", "episode/length")
_ENDED_BY = "ended_by"
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
        wholes: ``(3, S)`` int64, all whole numbers that the kernel writes.
        numbers: ``(K, S)`` float64, all other values.
    """

    def __init__(self, keys: Sequence[str], count: int) -> None:
        self.wholes = np.zeros((len(WHOLE_INFOS), count), np.int64)
        other_keys = [key for key in keys if key not in (*WHOLE_INFOS, _ENDED_BY)]
        self.numbers = np.zeros((len(other_keys), count))
        self.has = np.zeros(count, np.bool_)
        rows = {
            **dict(zip(WHOLE_INFOS, self.wholes, strict=True)),
            **dict(zip(other_keys, self.numbers, strict=True)),
            _ENDED_BY: np.zeros(count, np.int64),
        }
        self.columns: dict[str, npt.NDArray[Any]] = {key: rows[key] for key in keys}


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
        record: rewards, ends and infos of the episode.
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
        agents, opponents = kart_indices[: len(rewards)], kart_indices[len(rewards) :]
        self.race = RaceInfo(
            track=setup.track,
            reverse=setup.reverse,
            mode=setup.mode,
            laps=setup.laps,
            difficulty=setup.difficulty,
            seed=setup.seed,
            step_size=setup.step_size,
            kart_indices=agents,
            kart_types=start.kart_types,
            opponent_indices=opponents,
            opponents=tuple(setup.karts[kart].name for kart in opponents),
        )
        self.track_map = decode_track(start.track)
        self.snapshot = start.snapshot
        self.step_size = setup.step_size
        self._number_of = {f"kart_{number}": number for number in range(len(kart_indices))}
        self._karts = np.array(kart_indices, np.intp)
        self._players = np.flatnonzero([not kart.is_bot for kart in setup.karts])
        self.num_players = len(self._players)
        self._latest_seats: tuple[tuple[Sequence[str], Seats], ...] = ()
        self._past: Any = None  # (earlier history, latest controls), shared by copies
        self._start(options, rewards)

    def copy(self) -> Episode:
        """Returns an independent copy of the episode at this moment."""
        twin = copy.copy(self)
        shared = {id(reward): reward for reward in self._rewards.values()}
        twin.record = copy.deepcopy(self.record, shared)
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
        self.record.score(before, snapshot, seats, is_over, slots, ends)

    def infos_into(self, seats: Seats, slots: IntArray, table: InfoTable) -> None:
        """Writes the infos of some agents into a table with the keys of :attr:`record`."""
        self.record.infos_into(self.snapshot, seats, self._num_steps, slots, table)

    def infos(self, seats: Seats) -> dict[str, dict[str, Any]]:
        """Returns new infos of some agents; see :meth:`EpisodeRecord.infos`."""
        return self.record.infos(self.snapshot, seats, self._num_steps)

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
        self._rewards = rewards
        race_length = self.track_map.length * self.race.laps
        endings = endings_of(options, len(rewards))
        events = None
        if options.events or endings is not None:
            events = RaceEvents(self.track_map, self.setup.step_size, len(self.setup.karts))
        self.record = EpisodeRecord(
            rewards, self.race.kart_indices, race_length, events, endings, options.events
        )
        self._num_steps = 0
        self._max_cycles = options.max_cycles
        num_nodes = self.track_map.num_nodes
        num_paths = min(num_nodes, options.max_paths or num_nodes)
        self.course = self.track_map.graph, num_paths, tuple(self.race.kart_types)


class EpisodeRecord:
    """Rewards, ends and infos of one episode.

    Args:
        rewards: reward of each agent, in agent order.
        kart_indices: kart of each agent, in agent order.
        race_length: number of laps times the lap length [m].
        events: event counter, needed for ``shows_events`` and ``endings``.
        endings: optional ends of episodes.
        shows_events: whether events are available in infos and to rewards.

    Attributes:
        info_keys: keys of every info, in order.
        ends: arrays for the rewards, terminations and truncations of all agents, for reuse.
    """

    def __init__(
        self,
        rewards: Mapping[str, Reward],
        kart_indices: Sequence[int],
        race_length: float,
        events: RaceEvents | None = None,
        endings: Endings | None = None,
        shows_events: bool = False,
    ) -> None:
        self._karts = np.array(kart_indices, np.intp)
        of_agent = [*rewards.values()]
        self._rewards = [*{id(reward): reward for reward in of_agent}.values()]
        same = [
            [candidate is reward for candidate in self._rewards].index(True) for reward in of_agent
        ]
        self._reward_of = np.array(same, np.intp)
        names = sorted({name for reward in self._rewards for name in reward.terms})
        self._columns = {name: column for column, name in enumerate(names)}
        self._custom = [
            (number, name)
            for number, reward in enumerate(self._rewards)
            for name, term in reward.terms.items()
            if not isinstance(term, KernelTerm)
        ]
        self._race_length, self._shows_events = race_length, shows_events
        self._events, self._endings = events, endings
        shown = EVENTS if shows_events else ()
        columns = [*(f"reward/{name}" for name in names), *(f"event/{name}" for name in shown)]
        self._last = np.zeros((len(of_agent), len(columns)))
        self._sums = np.zeros_like(self._last)
        self.info_keys = (
            *("position", "distance", "lap", "finish_time"),
            *columns,
            *(f"episode/{column}" for column in columns),
            *("episode/return", "episode/length"),
            *(() if endings is None else (_ENDED_BY,)),
        )
        terminations, truncations = np.zeros((2, len(of_agent)), np.bool_)
        self.ends: EndArrays = np.zeros(len(of_agent)), terminations, truncations
        self._make_scorer()

    def score(
        self,
        before: Snapshot,
        after: Snapshot,
        seats: Seats,
        is_over: bool,
        slots: IntArray,
        ends: EndArrays,
    ) -> None:
        """Computes the rewards and ends of one step and adds them to the record.

        Args:
            before: snapshot before the step.
            after: snapshot after the step.
            seats: the agents that were still racing.
            is_over: whether the time limit is reached.
            slots: slot of each agent.
            ends: rewards, terminations and truncations of all slots; changed in place.
        """
        self._prepare(before, after)
        self._scorer.score_into(before.data, after.data, is_over, seats.numbers, slots, *ends)
        if self._endings is not None and self._events is not None:
            self._endings.end(ends, slots, seats.numbers, after, self._events.seconds[seats.karts])

    def infos(self, snapshot: Snapshot, seats: Seats, length: int) -> dict[str, dict[str, Any]]:
        """Returns new infos of some agents: plain numbers under the same keys in every step.

        ``position`` is the rank, ``distance`` the distance driven [m], ``lap`` the number of
        completed laps, and ``finish_time`` the finish time [s] (0 before the finish).
        ``reward/<term>`` is the weighted term of this step and ``episode/reward/<term>`` its sum;
        ``episode/return`` is the return and ``episode/length`` the number of steps. With events,
        ``event/<name>`` and ``episode/event/<name>`` count the events of
        :data:`stkzoo.mdp.events.EVENTS`. With optional ends, ``ended_by`` is an
        :class:`~stkzoo.names.EndReason`.

        Args:
            snapshot: current snapshot.
            seats: the agents.
            length: number of steps so far.
        """
        self.infos_into(snapshot, seats, length, seats.order, self._table)
        infos: dict[str, dict[str, Any]] = split_batch(self._table.columns, seats.agents)
        return infos

    def infos_into(
        self, snapshot: Snapshot, seats: Seats, length: int, slots: IntArray, table: InfoTable
    ) -> None:
        """Writes the infos of some agents into a table.

        Args:
            snapshot: see :meth:`infos`.
            seats: see :meth:`infos`.
            length: see :meth:`infos`.
            slots: slot of each agent.
            table: a table with :attr:`info_keys`; changed in place.
        """
        tables = table.wholes, table.numbers
        self._scorer.infos_into(snapshot.data, length, seats.numbers, slots, *tables)
        if self._endings is not None:
            table.columns[_ENDED_BY][slots] = self._endings.reasons[seats.numbers]

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
        for number, name in self._custom:
            agents = np.flatnonzero(self._reward_of == number)
            values = self._rewards[number].value(name, step)[self._karts[agents]]
            self._last[agents, self._columns[name]] = values

    def _make_scorer(self) -> None:
        """Makes the scorer and a table for infos, which share memory with arrays of the record."""
        self._table = InfoTable(self.info_keys, len(self._karts))
        rewards = []
        for reward in self._rewards:
            terms = [(n, t) for n, t in reward.terms.items() if isinstance(t, KernelTerm)]
            weights = np.array([reward.weights.get(name, 1.0) for name, _ in terms], np.float64)
            columns = np.array([self._columns[name] for name, _ in terms], np.intp)
            rewards.append((tuple(term.name for _, term in terms), weights, columns))
        events = self._shown_events
        if events is None:
            events = np.zeros((int(self._karts.max()) + 1, 0))
        numbers = self._last, self._sums, self._race_length
        self._scorer = StepScorer(self._karts, self._reward_of, *numbers, tuple(rewards), events)

    def __getstate__(self) -> dict[str, Any]:
        remade = ("_scorer", "_table")  # a copy of the arrays makes its own
        return {name: value for name, value in vars(self).items() if name not in remade}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._make_scorer()


class Endings:
    """Ends the episodes of agents that fail, and of all others after the first finish.

    An agent whose kart is stuck, drives in the wrong direction or is off the road for too long is
    *terminated*: it has failed, and its future reward is zero. Agents that are still racing after
    the first finish are *truncated*: the race would continue for them.

    Args:
        options: options of the episode.
        count: number of agents, A.

    Attributes:
        reasons: ``(A,)`` int64, an :class:`~stkzoo.names.EndReason` for each agent.
    """

    def __init__(self, options: RaceOptions, count: int) -> None:
        limits = options.end_off_road, options.end_when_wrong_way, options.end_when_stuck
        self._limits = [np.inf if limit is None else limit for limit in limits]
        self._steps_left = options.end_when_first_finishes
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
        is_cut = self._is_cut(after)
        fails = seconds > np.array(self._limits) - 1e-6  # float sums are inexact
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

    def _is_cut(self, after: Snapshot) -> bool:
        """Whether the chosen number of steps has passed since the first finish."""
        if self._steps_left is None or not after.karts["has_finished_race"].any():
            return False
        self._steps_left -= 1
        return self._steps_left < 0


def endings_of(options: RaceOptions, count: int) -> Endings | None:
    """Returns the ends that the options request for some agents; ``None`` if there are none."""
    chosen = (
        *(options.end_off_road, options.end_when_wrong_way, options.end_when_stuck),
        options.end_when_first_finishes,
    )
    return None if chosen == (None,) * 4 else Endings(options, count)
