"""The plan of a benchmark, and of time trials against the human world records."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from stkzoo._checks import check_whole
from stkzoo.config import NORMAL, TIME_TRIAL
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.agents import BatchAgent, find_agents
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.evaluation.batch.plan import BatchPlan, check_directions, find_tracks
from stkzoo.evaluation.benchmark.ai_times import load_ai_times
from stkzoo.evaluation.benchmark.races import (
    FORMS,
    BenchmarkForm,
    BenchmarkRace,
    direction_name,
    make_races,
    steps_within,
)
from stkzoo.race.settings import RaceSettings
from stkzoo.records import HUMAN_RECORDS, RECORD_DIFFICULTY, RECORD_KART

#: Time limit of a race, as a multiple of the AI's median time or of the human record.
LIMIT = 3.0
_MAX_SEEDS = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchmarkPlan(BatchPlan):
    """The plan of a benchmark. It determines the races.

    Attributes:
        agents: the agent to measure.
        split: the tracks as the user named them.
        seeds: number of races for each track, direction, form and end of the grid.
        limit: time limit of a race, as a multiple of the time with which the agent's is compared.
        directions: ``False`` for forward, ``True`` for reversed.
        forms: names of race forms (:class:`~stkzoo.evaluation.BenchmarkForm`).
        ai_times: the AI's median times [s], by track and by ``"forward"`` or ``"reversed"``; empty
            for time trials, which are compared with the human records.
    """

    type_name: ClassVar[str] = "benchmark-plan"
    noun: ClassVar[str] = "benchmark"
    resume_command: ClassVar[str] = "stkzoo benchmark AGENT --output {folder}"
    decided: ClassVar[tuple[str, ...]] = (
        *("track", "laps", "difficulty", "reverse", "seed", "mode", "kart"),
        *("max_steps", "max_steps_after_first", "karts_finished"),
    )
    changeable: ClassVar[tuple[str, ...]] = ("split",)
    #: Whether rivals can be drivers of a population.
    has_population: ClassVar[bool] = False

    agents: Annotated[tuple[BatchAgent, ...], Meta(min_length=1, max_length=1)]
    split: str
    seeds: int
    limit: Annotated[float, Meta(gt=0, le=1000)] = LIMIT
    directions: Annotated[tuple[bool, ...], Meta(min_length=1, max_length=2)]
    forms: Annotated[tuple[str, ...], Meta(min_length=1, max_length=400)]
    ai_times: Mapping[str, Mapping[str, Annotated[float, Meta(gt=0, le=1e5)]]]

    def __post_init__(self) -> None:
        for form in self._forms():
            if form.has_population and not self.has_population:
                raise ConfigError(
                    f"race form {form.name!r} has karts of a population (B), which only tasks of "
                    "`stkzoo suite` have; expected A for each kart of the game's AI"
                )
        check_whole("seeds", self.seeds, 1, _MAX_SEEDS)
        ends = sum(len(form.ends) for form in self._forms())
        self.check_num_races(len(self.tracks) * len(self.directions) * ends * self.seeds)
        for track, reverse in itertools.product(self.tracks, self.directions):
            if self.is_time_trial:
                if track not in HUMAN_RECORDS:
                    raise ConfigError(f"{track} has no human record; leave it out of --track")
            elif direction_name(reverse) not in self.ai_times.get(track, {}):
                raise ConfigError(f"ai_times has no {track} ({direction_name(reverse)})")

    @property
    def is_time_trial(self) -> bool:
        """Whether the races are time trials, as those of the human records."""
        return self.settings.mode == TIME_TRIAL

    def races(self) -> tuple[BenchmarkRace, ...]:
        """Returns all races of the benchmark."""
        return make_races(self.tracks, self.directions, self._forms(), self.seeds)

    def _forms(self) -> tuple[BenchmarkForm, ...]:
        return tuple(map(BenchmarkForm.of, self.forms))

    def reference_time(self, track: str, reverse: bool) -> float:
        """Returns the time with which the agent's is compared [s].

        It is the AI's median time on a track in a direction; in time trials, the human record.
        """
        if self.is_time_trial:
            return HUMAN_RECORDS[track].seconds
        return self.ai_times[track][direction_name(reverse)]

    def orders(self) -> list[RaceOrder]:
        """Returns the orders of all races."""
        return [self._order(race) for race in self.races()]

    def _order(self, race: BenchmarkRace) -> RaceOrder:
        karts = race.lineup.agent_karts(race.end)
        settings = replace(
            self.settings,
            track=race.track,
            reverse=race.reverse,
            laps=HUMAN_RECORDS[race.track].laps if self.is_time_trial else 1,
            seed=race.seed,
            max_steps=steps_within(self.limit * self.reference_time(race.track, race.reverse)),
        )
        drivers = (self.agent.text if kart in karts else "ai" for kart in range(len(race.form)))
        return RaceOrder(race.number, tuple(drivers), settings, karts)


def _measured_settings(
    settings: RaceSettings | None, changes: Mapping[str, Any], **conditions: Any
) -> RaceSettings:
    """Returns the settings of all races.

    Args:
        settings: settings of the user.
        changes: fields that replace those of ``settings``.
        **conditions: conditions of the races, which users cannot set.

    Raises:
        ConfigError: the user sets a field in ``BenchmarkPlan.decided``, or a value is invalid.
    """
    limits = ("max_steps", "max_steps_after_first", "karts_finished")
    unset: dict[str, Any] = dict.fromkeys(("track", *limits))
    chosen = BenchmarkPlan.settings_of(settings, changes)
    return replace(chosen, **unset, laps=1, **conditions)


def plan_benchmark(
    agent: str,
    *,
    split: str | Sequence[str] = "test",
    difficulty: int = 3,
    forms: Sequence[str] = FORMS,
    seeds: int = 5,
    reverse: Sequence[bool] = (False, True),
    settings: RaceSettings | None = None,
    **changes: Any,
) -> BenchmarkPlan:
    """Plans a benchmark.

    Args:
        agent: the agent to measure: the name of a driver, the path of a folder or zip, or a module;
            append ``@:Name`` to rename it.
        split: name of a split (:data:`stkzoo.tracks.SPLITS`), or names of tracks.
        difficulty: skill of the game's AI and speed of all karts, 0 to 3.
        forms: race forms; ``"PAAAA"`` means one kart of the agent and four of the AI.
        seeds: number of races for each track, direction, form and end of the grid.
        reverse: the directions: ``False`` for forward, ``True`` for reversed.
        settings: settings of every race. The benchmark itself sets the fields in
            ``BenchmarkPlan.decided``.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that replace those of
            ``settings``.

    Raises:
        ConfigError: an argument is invalid, or the agent or a track does not exist.
        AssetError: the game's data is missing.
    """
    chosen = _measured_settings(settings, changes, mode=NORMAL, kart=None, difficulty=difficulty)
    tracks, directions = find_tracks(split, chosen), check_directions(reverse)
    names = (forms,) if isinstance(forms, str) else tuple(forms)
    if not names or len(set(names)) < len(names):
        raise ConfigError(
            f"forms is {names}, expected different race forms, such as {', '.join(FORMS)}"
        )
    times = load_ai_times()
    return BenchmarkPlan(
        agents=find_agents([agent], chosen),
        split=split if isinstance(split, str) else " ".join(split),
        tracks=tracks,
        directions=directions,
        forms=names,
        seeds=seeds,
        ai_times={
            track: {
                direction_name(way): times.of(track, way, difficulty).median for way in directions
            }
            for track in tracks
        },
        settings=chosen,
    )


def plan_time_trial(
    agent: str,
    *,
    split: str | Sequence[str] = "all",
    seeds: int = 1,
    settings: RaceSettings | None = None,
    **changes: Any,
) -> BenchmarkPlan:
    """Plans time trials under the conditions of the human world records.

    Args:
        agent: the agent to measure; see :func:`plan_benchmark`.
        split: name of a split (:data:`stkzoo.tracks.SPLITS`), or names of tracks.
        seeds: number of races on each track.
        settings: settings of every race. The time trials set the fields in
            ``BenchmarkPlan.decided``.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that replace those of
            ``settings``.

    Raises:
        ConfigError: an argument is invalid, the agent or a track does not exist, or a track has no
            record.
        AssetError: the game's data is missing.
    """
    conditions = {"kart": RECORD_KART, "difficulty": RECORD_DIFFICULTY, "reverse": False}
    chosen = _measured_settings(settings, changes, mode=TIME_TRIAL, **conditions)
    return BenchmarkPlan(
        agents=find_agents([agent], chosen),
        split=split if isinstance(split, str) else " ".join(split),
        tracks=find_tracks(split, chosen),
        directions=(False,),
        forms=("P",),
        seeds=seeds,
        ai_times={},
        settings=chosen,
    )
