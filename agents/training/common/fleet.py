"""Parallel races for training and for matches, stepped as arrays."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stkzoo._schema import Place
from stkzoo.agents.planning import BoolArray, FloatArray, IntArray
from stkzoo.agents.planning.driver import (
    ALL_LOOKS,
    PlanDriver,
    PolicyInput,
    mirrored_choices,
    mirrored_inputs,
    mirrored_prior,
)
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.engine import WorkerSession
from stkzoo.evaluation import load_ai_times
from stkzoo.wrappers.racing import Surroundings

from .starts import Lineup, RaceStarts, StartingPoint

#: Time limit of a race, as a multiple of the AI's median time.
_PATIENCE = 1.6
#: Time limit after the first learner's finish [s].
_GRACE = 8.0
#: Longest distance per step [m]; a longer one is a jump at the start line or at a rescue.
_LONGEST_STEP = 8.0
#: Reward per meter.
_METER = 0.05
#: Upper limit of an estimated time ratio.
_WORST_RATIO = 10.0
#: Starting points per track, direction and lineup.
_VARIANTS = 2
#: Time ratio of a kart that does not finish.
_UNFINISHED = 3.0


@functools.cache
def ai_time(track: str, reverse: bool, difficulty: int) -> float:
    """Returns the median time of the game's AI [s]; the difficulty makes all karts faster."""
    return load_ai_times().of(track, reverse, difficulty).median


@dataclass(frozen=True, slots=True)
class Finish:
    """The end of a learner's race.

    Attributes:
        track: name of the track.
        reverse: whether the track was driven in reverse.
        lineup: lineup of the race.
        ratio: finish time over the AI's median time; ``None`` if the race was cut short.
        estimate: the ratio, estimated from the pace if the race was cut short; at most 10.
        rank: final rank, 1 is first.
    """

    track: str
    reverse: bool
    lineup: Lineup
    ratio: float | None
    estimate: float
    rank: Place

    @property
    def counted_ratio(self) -> float:
        """The time ratio; 3 if the race was cut short."""
        return _UNFINISHED if self.ratio is None else self.ratio


@dataclass(frozen=True, slots=True)
class FleetStep:
    """The outcome of a step, as arrays over the learners' S slots.

    Attributes:
        rewards: ``(S,)`` float32.
        active: ``(S,)`` bool, whether the kart was racing before the step.
        ended: ``(S,)`` bool, whether its race ended in this step, at the finish or cut short.
        finishes: one entry per ended kart.
        last_inputs: ``(S, F)``, last inputs of ended karts and zeros for others; empty for races
            without learners' inputs.
    """

    rewards: FloatArray
    active: BoolArray
    ended: BoolArray
    finishes: list[Finish]
    last_inputs: FloatArray = field(default_factory=lambda: np.zeros((0, 0), np.float32))


class FleetRace:
    """Successive races with one lineup.

    Args:
        lineup: lineup of the races.
        starts: provides their starts.
        place_reward: reward per place.
        slots: slots of its learners in the fleet.
    """

    def __init__(
        self, lineup: Lineup, starts: RaceStarts, place_reward: float, slots: IntArray
    ) -> None:
        self.slots = slots
        self.lineup, self._starts, self._place_reward = lineup, starts, place_reward
        self._session = WorkerSession(starts.root)

    def begin(self, track: str, reverse: bool, number: int) -> None:
        """Starts a race at the starting point ``number``."""
        self.start = StartingPoint(track, reverse, number, self.lineup)
        self._ai_time = ai_time(track, reverse, self.lineup.difficulty)
        self.snapshot = self._starts.begin(self.start, self._session)
        is_bot = np.array([kart.is_bot for kart in self.start.setup().karts])
        self.karts = np.flatnonzero(~is_bot)
        self.racing = np.ones(len(self.karts), bool)
        self.road = self._starts.road(self.start)
        self.length = self._starts.tables[self.road].length
        self.first_finish: float | None = None

    def send(self, controls: FloatArray) -> None:
        """Starts a step; a race that has ended does not move."""
        self._is_driving = bool(self.racing.any())
        if self._is_driving:
            self._session.step_async(controls)

    def receive(self) -> tuple[FloatArray, BoolArray, list[Finish]]:
        """Returns rewards and ends of the learners' karts; see :class:`FleetStep`."""
        if not self._is_driving:
            return np.zeros(len(self.racing), np.float32), np.zeros(len(self.racing), bool), []
        before, self.snapshot = self.snapshot, self._session.step_wait()
        old, new = before.karts[self.karts], self.snapshot.karts[self.karts]
        half = self.length / 2
        moved = new["distance_down_track"] - old["distance_down_track"]
        moved = (moved + half) % self.length - half
        moved[np.abs(moved) > _LONGEST_STEP] = 0.0
        rewards = _METER * moved + self._place_reward * (old["position"] - new["position"])
        finished = self.racing & (new["has_finished_race"] > 0)
        time = float(self.snapshot.header["time"])
        if finished.any() and self.first_finish is None:
            self.first_finish = time
        is_late = time > _PATIENCE * self._ai_time or (
            self.first_finish is not None and time > self.first_finish + _GRACE
        )
        ended = self.racing if is_late else finished
        rewards = np.where(self.racing, rewards, 0).astype(np.float32)
        finishes = [
            self._finish(new[row], bool(finished[row]), time) for row in np.flatnonzero(ended)
        ]
        self.racing = self.racing & ~ended
        return rewards, ended.copy(), finishes

    def _finish(self, kart: np.void, is_finished: bool, time: float) -> Finish:
        ratio = float(kart["finish_time"]) / self._ai_time if is_finished else None
        share = max(float(kart["overall_distance"]) / self.length, 1e-6)
        estimate = min(time / self._ai_time / share if ratio is None else ratio, _WORST_RATIO)
        start = self.start
        rank = int(kart["position"])
        return Finish(start.track, start.reverse, self.lineup, ratio, estimate, rank)

    def close(self) -> None:
        """Ends the race."""
        self._session.close()


class RaceFleet:
    """Parallel races; the kart of each learner is a slot.

    Args:
        lineups: lineup of each race.
        starts: starting points to share with another fleet.
        place_reward: reward per place; the reward per meter is 0.05.
        sees_line: whether the surroundings include the racing line.

    Attributes:
        races: the race of each lineup.
        num_slots: number of learners.
    """

    def __init__(
        self,
        lineups: Sequence[Lineup],
        starts: RaceStarts | None = None,
        place_reward: float = 0.0,
        *,
        sees_line: bool = False,
    ) -> None:
        self.starts, self._sees_line = starts or RaceStarts(), sees_line
        self.num_slots = sum(lineup.learners for lineup in lineups)
        ends = np.cumsum([lineup.learners for lineup in lineups])
        self.races = [
            FleetRace(lineup, self.starts, place_reward, np.arange(end - lineup.learners, end))
            for lineup, end in zip(lineups, ends, strict=True)
        ]

    def start_at(self, places: Sequence[tuple[str, bool, int]]) -> None:
        """Starts each race at a track, a direction and a starting point."""
        for race, (track, reverse, number) in zip(self.races, places, strict=True):
            race.begin(track, reverse, number)

    @property
    def active(self) -> BoolArray:
        """``(S,)`` bool, whether each kart is racing."""
        return np.concatenate([race.racing for race in self.races])

    def send_controls(self, controls: FloatArray) -> None:
        """Starts a step with the engine's controls ``(S, 7)``."""
        controls[~self.active] = 0.0
        for race in self.races:
            race.send(controls[race.slots])

    def receive_step(self) -> FleetStep:
        """Waits for the step and returns its outcome."""
        active = self.active
        parts = [race.receive() for race in self.races]
        rewards, ended = (np.concatenate([part[column] for part in parts]) for column in (0, 1))
        return FleetStep(rewards, active, ended, [end for part in parts for end in part[2]])

    def surroundings(self) -> tuple[dict[str, Any], Surroundings]:
        """Returns own state and surroundings of the learners' karts."""
        races = (
            [race.snapshot for race in self.races],
            [race.road for race in self.races],
            [race.karts for race in self.races],
        )
        own, around = self.starts.view.surroundings(*races, ALL_LOOKS)
        if self._sees_line:
            around = replace(around, line=self.starts.racing_lines().ahead(*races))
        return own, around

    def close(self, *, with_starts: bool = True) -> None:
        """Closes all races, by default including the waiting ones."""
        for race in self.races:
            race.close()
        if with_starts:
            self.starts.close()


class Fleet(RaceFleet):
    """Parallel races of learners that choose among plans; a new race follows each ended one.

    Args:
        lineups: lineup of each race.
        tracks: tracks, drawn uniformly and in both directions.
        place_reward: reward per place; the reward per meter is 0.05.
        rules: parameters of the learners' plans.
        mirrors: whether half of the karts observe and act with left and right swapped.

    Attributes:
        drivers: plans and memory of the learners.
    """

    def __init__(
        self,
        lineups: Sequence[Lineup],
        tracks: Sequence[str],
        place_reward: float = 0.3,
        rules: DriverParameters | None = None,
        *,
        mirrors: bool = True,
    ) -> None:
        parameters = rules or DriverParameters()
        super().__init__(lineups, place_reward=place_reward, sees_line=parameters.racing_line)
        self._tracks, self._mirrors = tuple(tracks), mirrors
        self._random = np.random.default_rng()
        self.drivers = PlanDriver(self.num_slots, parameters)
        self._is_mirrored = np.zeros(self.num_slots, bool)

    def begin(self, seed: int | Sequence[int]) -> PolicyInput:
        """Starts all races; returns the first inputs of the learners.

        Args:
            seed: seed of these and all later races.
        """
        self._random = np.random.default_rng(seed)
        for number in range(len(self.races)):
            self._begin(number)
        return self._look(is_later=False)

    def send(self, choices: IntArray) -> BoolArray:
        """Starts a step with choices ``(S, 4)``.

        Returns:
            ``(S,)`` bool, whether the choices apply; a stuck kart frees itself instead.
        """
        chosen = np.where(self._is_mirrored[:, None], mirrored_choices(choices), choices)
        controls, is_driven = self.drivers.act(chosen)
        self.send_controls(controls)
        return is_driven

    def receive(self) -> tuple[PolicyInput, FleetStep]:
        """Waits for the step; returns the learners' next inputs and the outcome."""
        step = self.receive_step()
        view = self._look(is_later=True)
        last = np.zeros_like(view.inputs)
        last[step.ended] = view.inputs[step.ended]
        over = [n for n, race in enumerate(self.races) if not race.racing.any()]
        for number in over:
            self._begin(number)
        if over:
            view = self._look(is_later=False)
        return view, replace(step, last_inputs=last)

    def _begin(self, number: int) -> None:
        track = self._tracks[int(self._random.integers(len(self._tracks)))]
        reverse = bool(self._random.integers(2))
        self.races[number].begin(track, reverse, int(self._random.integers(_VARIANTS)))
        rows = self.races[number].slots
        self.drivers.forget(rows)
        self._is_mirrored[rows] = self._random.random(len(rows)) < 0.5 * self._mirrors

    def _look(self, is_later: bool) -> PolicyInput:
        look = self.drivers.look if is_later else self.drivers.view
        view = look(*self.surroundings())
        if not self._is_mirrored.any():
            return view
        is_mirrored = self._is_mirrored[:, None]
        return PolicyInput(
            np.where(is_mirrored, mirrored_inputs(view.inputs), view.inputs),
            np.where(is_mirrored, mirrored_prior(view.prior), view.prior),
        )
