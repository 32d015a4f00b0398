"""What a benchmark is to be, checked before the first race."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from stkzoo.errors import ConfigError, check_whole
from stkzoo.evaluation.batch import BatchKind, Entrant, RaceOrder, find_entrants
from stkzoo.evaluation.batch.plans import (
    find_tracks,
    read_form,
    settings_of,
    what_changed,
    write_form,
)
from stkzoo.evaluation.benchmark.ai_times import load_ai_times
from stkzoo.evaluation.benchmark.races import (
    DECIDED,
    FORMS,
    BenchmarkRace,
    RaceForm,
    direction_name,
    make_races,
)
from stkzoo.race.result import versions_now
from stkzoo.race.settings import RaceSettings

__all__ = ["BENCHMARK", "BenchmarkPlan", "plan_benchmark"]

#: Of the JSON form; grows when a plan would lead to other races.
_VERSION = 1
_KIND = "benchmark-plan"
#: A kart is not waited for after so many times the AI's median time.
_LIMIT = 3.0
_MAX_SEEDS = 10_000
_STEP, _COUNTDOWN = 0.1, 20  # [s], and steps before the race's clock runs


@dataclass(frozen=True, slots=True)
class BenchmarkPlan:
    """A whole benchmark, from which its races follow.

    Attributes:
        agent: who is measured.
        split: the tracks as they were asked for.
        tracks: the tracks.
        directions: ``False`` is forward, ``True`` is reversed.
        forms: who drives.
        seeds: how many races of each kind.
        limit: after this multiple of the AI's median time a race is over.
        ai_times: that time [s], by track and ``"forward"`` or ``"reversed"``.
        settings: of every race.
        versions: of the software.
    """

    agent: Entrant
    split: str
    tracks: tuple[str, ...]
    directions: tuple[bool, ...]
    forms: tuple[RaceForm, ...]
    seeds: int
    limit: float
    ai_times: Mapping[str, Mapping[str, float]]
    settings: RaceSettings
    versions: Mapping[str, str]

    def races(self) -> tuple[BenchmarkRace, ...]:
        """All races."""
        return make_races(self.tracks, self.directions, self.forms, self.seeds)

    def ai_time(self, track: str, reverse: bool) -> float:
        """The AI's median time there [s]."""
        return self.ai_times[track][direction_name(reverse)]

    def orders(self) -> list[RaceOrder]:
        """All races, as they are to be run."""
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

    def to_json(self) -> str:
        """The plan as JSON."""
        return write_form(_KIND, _VERSION, self.to_form())

    def to_form(self) -> dict[str, Any]:
        """The plan as what JSON can hold."""
        return {**asdict(self), "forms": [form.name for form in self.forms]}

    @classmethod
    def from_json(cls, text: str) -> BenchmarkPlan:
        """Reads what :meth:`to_json` wrote.

        Raises:
            ConfigError: it is something else, or of another version.
        """
        return cls.from_form(read_form(text, _KIND, _VERSION))

    @classmethod
    def from_form(cls, form: Mapping[str, Any]) -> BenchmarkPlan:
        """Reads what :meth:`to_form` gave.

        Raises:
            ConfigError: it is something else.
        """
        try:
            check_whole("seeds", form["seeds"], 1, _MAX_SEEDS)
            return cls(
                **{
                    **form,
                    "agent": Entrant(**form["agent"]),
                    "tracks": tuple(form["tracks"]),
                    "directions": tuple(form["directions"]),
                    "forms": tuple(map(RaceForm.of, form["forms"])),
                    "settings": RaceSettings(**form["settings"]),
                }
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ConfigError(
                f"the plan of the benchmark cannot be read ({type(error).__name__}: {error})"
            ) from error

    def differences(self, other: BenchmarkPlan) -> list[str]:
        """What another plan has otherwise, in words."""
        return what_changed(_flat(self), _flat(other), [(self.agent, other.agent)])

    def differing_conditions(self, other: BenchmarkPlan) -> list[str]:
        """What keeps the results of two agents from being compared, in words."""
        mine, theirs = _conditions(self), _conditions(other)
        shared = {"engine", "difficulty", "limit", *(set(mine) & set(theirs))}
        return what_changed(
            {name: mine.get(name) for name in shared},
            {name: theirs.get(name) for name in shared},
            (),
        )


BENCHMARK = BatchKind(
    "benchmark", BenchmarkPlan.from_json, "stkzoo benchmark AGENT --output {folder}"
)


def _flat(plan: BenchmarkPlan) -> dict[str, Any]:
    settings = {k: v for k, v in asdict(plan.settings).items() if k not in DECIDED}
    return settings | {
        **_conditions(plan),
        "agent": plan.agent.text,
        "tracks": list(plan.tracks),
        "directions": [direction_name(reverse) for reverse in plan.directions],
        "forms": [form.name for form in plan.forms],
        "seeds": plan.seeds,
        "stkzoo": plan.versions.get("stkzoo"),
    }


def _conditions(plan: BenchmarkPlan) -> dict[str, Any]:
    times = {
        f"the AI's time on {track} ({direction})": time
        for track, of_track in plan.ai_times.items()
        for direction, time in of_track.items()
    }
    return times | {
        "engine": plan.versions.get("pystk2"),
        "difficulty": plan.settings.difficulty,
        "limit": plan.limit,
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
        agent: who is measured: a driver's name, a path of a folder or zip, a module, with
            ``@:Name`` behind it to call it something else.
        split: ``"test"``, ``"train"``, ``"all"``, or names of tracks.
        difficulty: level of the game's AI, 0 to 3.
        forms: who drives: ``"PAAAA"`` is the agent and four of the AI.
        seeds: how many races of each kind: form, end of the grid, track and direction.
        reverse: the directions: ``False`` is forward, ``True`` is reversed.
        ai_times: a file with the AI's times; by default those that come with stkzoo.
        settings: of every race; what :data:`~stkzoo.evaluation.benchmark.races.DECIDED` names in it
            does not count.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that are other than in
            ``settings``.

    Raises:
        ConfigError: an argument cannot be, or there is no such agent or track.
        AssetError: the game's data is missing.
    """
    chosen = replace(
        settings_of(settings, changes, DECIDED),
        track=None,
        laps=1,
        difficulty=difficulty,
        max_steps=None,
        max_steps_after_first=None,
        karts_finished=None,
    )
    check_whole("seeds", seeds, 1, _MAX_SEEDS)
    tracks = find_tracks(split, chosen)
    directions, found = _directions(reverse), _forms(forms)
    (entrant,) = find_entrants([agent], chosen)
    times = load_ai_times(ai_times)
    return BenchmarkPlan(
        agent=entrant,
        split=split if isinstance(split, str) else " ".join(split),
        tracks=tracks,
        directions=directions,
        forms=found,
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


def _directions(reverse: Sequence[bool]) -> tuple[bool, ...]:
    found = tuple(reverse) if isinstance(reverse, Sequence) else (reverse,)
    if not found or len(set(found)) < len(found) or not set(found) <= {False, True}:
        raise ConfigError(
            f"reverse is {reverse!r}, expected (False, True) or one of both: False is forward"
        )
    return tuple(map(bool, found))


def _forms(forms: Sequence[str]) -> tuple[RaceForm, ...]:
    names = [forms] if isinstance(forms, str) else list(forms)
    if not names or len(set(names)) < len(names):
        raise ConfigError(
            f"forms is {names}, expected different race forms, such as {', '.join(FORMS)}"
        )
    return tuple(map(RaceForm.of, names))
