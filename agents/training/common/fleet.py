"""Races for learning: many at a time, stepped as arrays, begun again when they end.

A race begins as a copy of one that stands at GO (a copy takes milliseconds, a start a tenth of
a second), one such race being kept for each track, direction, form and number. Whatever is drawn
comes from a generator whose state can be kept, and a race under way is kept as the controls since
GO: so a fleet comes back exactly after the program has died.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning import (
    ALL_LOOKS,
    DriverParameters,
    PlanDriver,
    PolicyInput,
    mirrored_choices,
    mirrored_inputs,
    mirrored_prior,
)
from stkzoo.engine.assets import find_assets
from stkzoo.engine.session import WorkerSession
from stkzoo.engine.setup import KartSetup, RaceSetup
from stkzoo.engine.snapshot import Snapshot
from stkzoo.engine.track import TrackMap, decode_track
from stkzoo.evaluation import load_ai_times
from stkzoo.names import Phase
from stkzoo.wrappers.racing import BatchedRacingView, RoadTable

__all__ = ["Beginning", "Finish", "Fleet", "RaceForm", "StepOutcome"]

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]
#: Track, whether the other way round, and number of a race's beginning.
Beginning = tuple[str, bool, int]

#: A race is cut short after so many times the AI's median time.
_PATIENCE = 1.6
#: And so long after the first learner has finished [s].
_GRACE = 8.0
#: Nobody drives farther in a step [m]; the engine's distance jumps at the line and at rescues.
_LONGEST_STEP = 8.0
#: Reward of a metre.
_METRE = 0.05


@dataclass(frozen=True, slots=True)
class RaceForm:
    """Who drives: so many learners and so many of the game's AI."""

    learners: int
    rivals: int
    difficulty: int = 3


@dataclass(frozen=True, slots=True)
class _Kind:
    """Races that begin alike."""

    track: str
    reverse: bool
    form: RaceForm
    number: int

    def setup(self) -> RaceSetup:
        """What the engine is told; the places on the grid come from the number."""
        seed = np.random.SeedSequence(
            [self.number, self.reverse, self.form.learners, self.form.rivals, *self.track.encode()]
        )
        random = np.random.default_rng(seed)
        karts = [KartSetup(is_bot=False)] * self.form.learners + [KartSetup()] * self.form.rivals
        order = random.permutation(len(karts))
        return RaceSetup(
            track=self.track,
            karts=tuple(karts[place] for place in order),
            reverse=self.reverse,
            difficulty=self.form.difficulty,
            seed=int(random.integers(2**16)),
        )


@dataclass(frozen=True, slots=True)
class Finish:
    """A learner's race that has ended: its time over the AI's median time, ``None`` if unfinished.

    ``rank`` is its place, and ``karts`` how many drove.
    """

    track: str
    reverse: bool
    form: RaceForm
    ratio: float | None
    rank: int
    karts: int


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """What came of a step; arrays over the learners' slots.

    Attributes:
        rewards: ``(S,)`` float32.
        active: ``(S,)``: who was racing before the step.
        ended: ``(S,)``: whose race ended in it, by the finish or cut short.
        last_inputs: ``(S, F)``: what those saw last; zeros for the others.
        finishes: one for each that ended.
    """

    rewards: FloatArray
    active: BoolArray
    ended: BoolArray
    last_inputs: FloatArray
    finishes: list[Finish]


class _Parked:
    """Races that stand at GO, by kind, each started when it is first asked for."""

    def __init__(self) -> None:
        self._root = find_assets().root
        self._sessions: dict[_Kind, tuple[WorkerSession, Snapshot]] = {}
        self._roads: dict[tuple[str, bool], int] = {}
        self._tables: list[RoadTable] = []
        self.crowd = BatchedRacingView([])

    def new_session(self) -> WorkerSession:
        return WorkerSession(self._root)

    def begin(self, kind: _Kind, session: WorkerSession) -> Snapshot:
        """Begins a race of a kind in a session; its first moment."""
        if kind not in self._sessions:
            self._sessions[kind] = self._park(kind)
        parked, snapshot = self._sessions[kind]
        session.resume(parked)
        return snapshot

    def _park(self, kind: _Kind) -> tuple[WorkerSession, Snapshot]:
        session = self.new_session()
        start = session.start(kind.setup())
        self._take_in(kind, decode_track(start.track))
        snapshot = start.snapshot
        full_throttle = np.zeros((kind.form.learners, 7), np.float32)
        full_throttle[:, 0] = 1.0
        while snapshot.phase < Phase.GO_PHASE:
            snapshot = session.step(full_throttle)
        return session, snapshot

    def _take_in(self, kind: _Kind, track: TrackMap) -> None:
        key = kind.track, kind.reverse
        if key not in self._roads:
            self._roads[key] = len(self._tables)
            self._tables.append(RoadTable(track))
            self.crowd = BatchedRacingView(self._tables)

    def road(self, kind: _Kind) -> int:
        """The number of a kind's road in ``crowd``; the kind has begun before."""
        return self._roads[kind.track, kind.reverse]

    def length(self, kind: _Kind) -> float:
        """The length of a lap [m]."""
        return self._tables[self.road(kind)].length

    def close(self) -> None:
        for session, _ in self._sessions.values():
            session.close()
        self._sessions.clear()


class _Race:
    """One race after another of one form."""

    def __init__(self, form: RaceForm, parked: _Parked, place_reward: float) -> None:
        self.form, self._parked, self._place_reward = form, parked, place_reward
        self._session = parked.new_session()
        self.kind: _Kind | None = None

    def begin(self, kind: _Kind, limit: float) -> None:
        self.kind, self._limit = kind, limit
        self.snapshot = self._parked.begin(kind, self._session)
        is_bot = np.array([kart.is_bot for kart in kind.setup().karts])
        self.karts = np.flatnonzero(~is_bot)
        self.racing = np.ones(len(self.karts), bool)
        self.length = self._parked.length(kind)
        self.road = self._parked.road(kind)
        self.controls: list[FloatArray] = []
        self.first_finish: float | None = None

    def send(self, controls: FloatArray) -> None:
        """Asks for a step; a race that is over stands still."""
        self._is_driving = bool(self.racing.any())
        if self._is_driving:
            self.controls.append(controls)
            self._session.step_async(controls)

    def receive(self) -> tuple[FloatArray, BoolArray, list[Finish]]:
        """Rewards and ends of the learners' karts; see :class:`StepOutcome`."""
        if not self._is_driving:
            return np.zeros(len(self.racing), np.float32), np.zeros(len(self.racing), bool), []
        before, self.snapshot = self.snapshot, self._session.step_wait()
        old, new = before.karts[self.karts], self.snapshot.karts[self.karts]
        half = self.length / 2
        moved = new["distance_down_track"] - old["distance_down_track"]
        moved = (moved + half) % self.length - half
        moved[np.abs(moved) > _LONGEST_STEP] = 0.0
        rewards = _METRE * moved + self._place_reward * (old["position"] - new["position"])
        finished = self.racing & (new["has_finished_race"] > 0)
        time = float(self.snapshot.header["time"])
        if finished.any() and self.first_finish is None:
            self.first_finish = time
        is_late = time > self._limit or (
            self.first_finish is not None and time > self.first_finish + _GRACE
        )
        ended = self.racing if is_late else finished
        rewards = np.where(self.racing, rewards, 0).astype(np.float32)
        finishes = [self._finish(new[row], bool(finished[row])) for row in np.flatnonzero(ended)]
        self.racing = self.racing & ~ended
        return rewards, ended.copy(), finishes

    def _finish(self, kart: np.void, is_finished: bool) -> Finish:
        assert self.kind is not None  # noqa: S101 - since begin
        ratio = float(kart["finish_time"]) / (self._limit / _PATIENCE) if is_finished else None
        count = self.form.learners + self.form.rivals
        return Finish(
            self.kind.track, self.kind.reverse, self.form, ratio, int(kart["position"]), count
        )

    def state(self) -> dict[str, Any]:
        assert self.kind is not None  # noqa: S101 - since begin
        kind = self.kind
        return {
            "kind": [kind.track, kind.reverse, kind.number],
            "controls": np.array(self.controls, np.float32).reshape(-1, len(self.karts), 7),
            "racing": self.racing.tolist(),
            "first_finish": self.first_finish,
        }

    def replay(self) -> None:
        """Takes in the step that was asked for, when it is driven again."""
        self.snapshot = self._session.step_wait()

    def resume(self, state: dict[str, Any]) -> None:
        """Goes on after the controls have been driven again."""
        self.racing = np.array(state["racing"], bool)
        self.first_finish = state["first_finish"]

    def close(self) -> None:
        self._session.close()


class Fleet:
    """Several races side by side; each learner's kart is a slot.

    Args:
        forms: the races' forms, one a race.
        tracks: their tracks; both directions are driven.
        seed: of all that is drawn.
        variants: how many different beginnings each track, direction and form has.
        place_reward: what a place is worth; a metre of way is worth 0.05.
        parked: beginnings to share with another fleet.
        rules: the numbers that the learners' plans go by.
        goes_on: whether races that are over begin anew.
        mirrors: whether half of the karts see and choose as if left were right.

    Attributes:
        drivers: what the learners see and remember.
    """

    def __init__(
        self,
        forms: Sequence[RaceForm],
        tracks: Sequence[str],
        seed: int,
        variants: int = 2,
        place_reward: float = 0.3,
        parked: _Parked | None = None,
        rules: DriverParameters | None = None,
        *,
        goes_on: bool = True,
        mirrors: bool = True,
    ) -> None:
        self.parked = parked or _Parked()
        self._tracks, self._variants, self._goes_on = tuple(tracks), variants, goes_on
        self._mirrors = mirrors
        self._random = np.random.default_rng(seed)
        self._times = load_ai_times()
        self._races = [_Race(form, self.parked, place_reward) for form in forms]
        self._first = np.cumsum([0, *(form.learners for form in forms)])
        self.num_slots = int(self._first[-1])
        self.drivers = PlanDriver(self.num_slots, rules)
        self._is_mirrored = np.zeros(self.num_slots, bool)

    def begin(self) -> PolicyInput:
        """Begins all races; what the learners see first."""
        for number in range(len(self._races)):
            self._begin(number)
        return self._look(is_later=False)

    def set_rules(self, rules: DriverParameters) -> None:
        """The learners' plans go by these numbers from the next beginning on."""
        self.drivers = PlanDriver(self.num_slots, rules)

    def begin_at(self, beginnings: Sequence[Beginning]) -> PolicyInput:
        """Begins each race as told, with nobody mirrored; what the learners see first."""
        for race, (track, reverse, number) in zip(self._races, beginnings, strict=True):
            kind = _Kind(track, reverse, race.form, number)
            race.begin(kind, self._limit(track, reverse, race.form))
        self.drivers.forget(np.arange(self.num_slots))
        self._is_mirrored[:] = False
        return self._look(is_later=False)

    @property
    def active(self) -> BoolArray:
        """``(S,)``: who is racing."""
        return np.concatenate([race.racing for race in self._races])

    def send(self, choices: IntArray) -> BoolArray:
        """Asks all races for a step with the choices ``(S, 4)``.

        Returns:
            ``(S,)``: who does what was chosen, and not what gets a stuck kart away.
        """
        chosen = np.where(self._is_mirrored[:, None], mirrored_choices(choices), choices)
        controls, is_driven = self.drivers.act(chosen)
        self.control(controls)
        return is_driven

    def control(self, controls: FloatArray) -> None:
        """Asks all races for a step with what the engine is told, ``(S, 7)``."""
        controls[~self.active] = 0.0
        for race, first in zip(self._races, self._first, strict=False):
            race.send(controls[first : first + race.form.learners])

    def receive(self) -> tuple[PolicyInput, StepOutcome]:
        """What the learners see after the step that was asked for, and what came of it."""
        active = self.active
        parts = [race.receive() for race in self._races]
        rewards, ended = (np.concatenate([part[column] for part in parts]) for column in (0, 1))
        finishes = [finish for part in parts for finish in part[2]]
        view = self._look(is_later=True)
        last = np.zeros_like(view.inputs)
        last[ended] = view.inputs[ended]
        over = [n for n, race in enumerate(self._races) if not race.racing.any()]
        over = over if self._goes_on else []
        for number in over:
            self._begin(number)
        if over:
            view = self._look(is_later=False)
        return view, StepOutcome(rewards, active, ended, last, finishes)

    def state(self) -> dict[str, Any]:
        """All of it between two steps, for :meth:`restore`."""
        return {
            "random": self._random.bit_generator.state,
            "races": [race.state() for race in self._races],
            "memory": self.drivers.state(),
            "is_mirrored": self._is_mirrored.copy(),
        }

    def restore(self, state: dict[str, Any]) -> PolicyInput:
        """Brings all back to what it was; what the learners saw then."""
        self._random.bit_generator.state = state["random"]
        self._drive_again(state["races"])
        self.drivers.restore(state["memory"])
        self._is_mirrored = np.array(state["is_mirrored"], bool)
        return self._look(is_later=False)

    def _drive_again(self, kept: Sequence[dict[str, Any]]) -> None:
        """Brings the races back to where they were, all at the same time."""
        for race, state in zip(self._races, kept, strict=True):
            track, reverse, number = state["kind"]
            limit = self._limit(track, reverse, race.form)
            race.begin(_Kind(track, reverse, race.form, number), limit)
        for step in range(max(len(state["controls"]) for state in kept)):
            under_way = [
                (race, state["controls"][step])
                for race, state in zip(self._races, kept, strict=True)
                if step < len(state["controls"])
            ]
            for race, controls in under_way:
                race.send(np.array(controls, np.float32))
            for race, _ in under_way:
                race.replay()
        for race, state in zip(self._races, kept, strict=True):
            race.resume(state)

    def close(self, *, with_parked: bool = True) -> None:
        """Ends all races, and those that stand at GO."""
        for race in self._races:
            race.close()
        if with_parked:
            self.parked.close()

    def _limit(self, track: str, reverse: bool, form: RaceForm) -> float:
        return _PATIENCE * self._times.of(track, reverse, form.difficulty).median

    def _begin(self, number: int) -> None:
        race = self._races[number]
        track = self._tracks[int(self._random.integers(len(self._tracks)))]
        reverse = bool(self._random.integers(2))
        kind = _Kind(track, reverse, race.form, int(self._random.integers(self._variants)))
        race.begin(kind, self._limit(track, reverse, race.form))
        rows = np.arange(self._first[number], self._first[number + 1])
        self.drivers.forget(rows)
        self._is_mirrored[rows] = self._random.random(len(rows)) < 0.5 * self._mirrors

    def _look(self, is_later: bool) -> PolicyInput:
        own, around = self.parked.crowd.surroundings(
            [race.snapshot for race in self._races],
            [race.road for race in self._races],
            [race.karts for race in self._races],
            ALL_LOOKS,
        )
        look = self.drivers.look if is_later else self.drivers.view
        view = look(own, around)
        if not self._is_mirrored.any():
            return view
        is_mirrored = self._is_mirrored[:, None]
        return PolicyInput(
            np.where(is_mirrored, mirrored_inputs(view.inputs), view.inputs),
            np.where(is_mirrored, mirrored_prior(view.prior), view.prior),
        )
