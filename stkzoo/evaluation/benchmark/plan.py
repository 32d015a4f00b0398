"""The plan of a benchmark, checked before the first race."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from stkzoo.errors import ConfigError, check_whole
from stkzoo.evaluation.batch.entrants import Entrant, find_entrants
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.evaluation.batch.plan import (
    BatchPlan,
    check_directions,
    choose_settings,
    describe_differences,
    find_tracks,
)
from stkzoo.evaluation.benchmark.ai_times import load_ai_times
from stkzoo.evaluation.benchmark.races import (
    DECIDED,
    FORMS,
    BenchmarkForm,
    BenchmarkRace,
    direction_name,
    make_races,
)
from stkzoo.race.result import versions_now
from stkzoo.race.settings import RaceSettings

#: A race ends after this multiple of the AI's median time.
_LIMIT = 3.0
_MAX_SEEDS = 10_000
_STEP, _COUNTDOWN = 0.1, 20  # [s], and steps before the race's clock runs


@dataclass(frozen=True, slots=True)
class BenchmarkPlan(BatchPlan):
    """A whole benchmark, from which its races follow.

    Attributes:
        agent: the agent to measure.
        split: the tracks as the user named them.
        tracks: the tracks.
        directions: ``False`` is forward, ``True`` is reversed.
        forms: names of :class:`~stkzoo.evaluation.BenchmarkForm`.
        seeds: races of each kind.
        limit: the multiple of the AI's median time after which a race ends.
        ai_times: that time [s], by track and ``"forward"`` or ``"reversed"``.
        settings: of every race.
        versions: of the software.
    """

    kind: ClassVar[str] = "benchmark-plan"
    noun: ClassVar[str] = "benchmark"
    resume_command: ClassVar[str] = "stkzoo benchmark AGENT --output {folder}"
    decided: ClassVar[tuple[str, ...]] = DECIDED

    agent: Entrant
    split: str
    tracks: tuple[str, ...]
    directions: tuple[bool, ...]
    forms: tuple[str, ...]
    seeds: int
    limit: float
    ai_times: Mapping[str, Mapping[str, float]]
    settings: RaceSettings
    versions: Mapping[str, str]

    def races(self) -> tuple[BenchmarkRace, ...]:
        """All races."""
        return make_races(self.tracks, self.directions, self._forms(), self.seeds)

    def _forms(self) -> tuple[BenchmarkForm, ...]:
        return tuple(map(BenchmarkForm.of, self.forms))

    def ai_time(self, track: str, reverse: bool) -> float:
        """The AI's median time there [s]."""
        return self.ai_times[track][direction_name(reverse)]

    def orders(self) -> list[RaceOrder]:
        """All races, ready to run."""
        return [self._order(race) for race in self.races()]

    def _order(self, race: BenchmarkRace) -> RaceOrder:
        places = race.form.places(race.end)
        karts = range(race.form.agents + race.form.rivals)
        longest = self.limit * self.ai_time(race.track, race.reverse)
        return RaceOrder(
            race.number,
            tuple(self.agent.text if place in places else "ai" for place in karts),
            replace(
                self.settings,
                track=race.track,
                reverse=race.reverse,
                seed=race.seed,
                max_steps=math.ceil(longest / _STEP) + _COUNTDOWN,
            ),
            places,
        )

    def check(self) -> None:
        """Checks the number of seeds and the forms."""
        check_whole("seeds", self.seeds, 1, _MAX_SEEDS)
        self._forms()

    def _entrants(self) -> tuple[Entrant, ...]:
        return (self.agent,)

    def _comparable(self) -> dict[str, Any]:
        values = BatchPlan._comparable(self)  # super() fails in slotted dataclasses
        del values["split"], values["ai_times"]
        directions = [direction_name(reverse) for reverse in self.directions]
        return values | self._conditions() | {"agent": self.agent.text, "directions": directions}

    def differing_conditions(self, other: BenchmarkPlan) -> list[str]:
        """The conditions that make two agents' results incomparable, as sentences."""
        mine, theirs = self._conditions(), other._conditions()
        shared = set(mine) & set(theirs)
        return describe_differences(
            {name: mine[name] for name in shared}, {name: theirs[name] for name in shared}
        )

    def _conditions(self) -> dict[str, Any]:
        times = {
            f"the AI's time on {track} ({direction})": time
            for track, of_track in self.ai_times.items()
            for direction, time in of_track.items()
        }
        return times | {
            "engine": self.versions.get("pystk2"),
            "difficulty": self.settings.difficulty,
            "limit": self.limit,
        }


def plan_benchmark(
    agent: str,
    *,
    split: str | Sequence[str] = "test",
    difficulty: int = 3,
    forms: Sequence[str] = FORMS,
    seeds: int = 5,
    reverse: Sequence[bool] = (False, True),
    ai_times: str | os.PathLike[str] | None = None,
    settings: RaceSettings | None = None,
    **changes: Any,
) -> BenchmarkPlan:
    """Plans a benchmark.

    Args:
        agent: the agent to measure: a driver's name, a path of a folder or zip, or a module; append
            ``@:Name`` to rename it.
        split: ``"test"``, ``"train"``, ``"all"``, or names of tracks.
        difficulty: level of the game's AI, 0 to 3.
        forms: race forms: ``"PAAAA"`` is one kart of the agent and four of the AI.
        seeds: races of each kind: form, end of the grid, track and direction.
        reverse: the directions: ``False`` is forward, ``True`` is reversed.
        ai_times: a file with the AI's times; by default those that come with stkzoo.
        settings: of every race; the benchmark sets the fields in
            :data:`~stkzoo.evaluation.benchmark.races.DECIDED` itself.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that replace those of
            ``settings``.

    Raises:
        ConfigError: an argument is invalid, or there is no such agent or track.
        AssetError: the game's data is missing.
    """
    chosen = replace(
        choose_settings(settings, changes, DECIDED),
        track=None,
        laps=1,
        difficulty=difficulty,
        max_steps=None,
        max_steps_after_first=None,
        karts_finished=None,
    )
    check_whole("seeds", seeds, 1, _MAX_SEEDS)
    tracks, directions = find_tracks(split, chosen), check_directions(reverse)
    names = (forms,) if isinstance(forms, str) else tuple(forms)
    if not names or len(set(names)) < len(names):
        raise ConfigError(
            f"forms is {names}, expected different race forms, such as {', '.join(FORMS)}"
        )
    times = load_ai_times(ai_times)
    (entrant,) = find_entrants([agent], chosen)
    plan = BenchmarkPlan(
        agent=entrant,
        split=split if isinstance(split, str) else " ".join(split),
        tracks=tracks,
        directions=directions,
        forms=names,
        seeds=seeds,
        limit=_LIMIT,
        ai_times={
            track: {
                direction_name(way): times.of(track, way, difficulty).median for way in directions
            }
            for track in tracks
        },
        settings=chosen,
        versions=versions_now(),
    )
    plan.check()
    return plan
