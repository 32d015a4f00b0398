"""The plan of a benchmark, and its result."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from stkzoo.config import NORMAL
from stkzoo.errors import ConfigError, check_whole
from stkzoo.evaluation.batch.agents import BatchAgent, find_agents
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.evaluation.batch.plan import (
    MAX_RESULT_BYTES,
    BatchPlan,
    batch_settings,
    check_directions,
    check_num_races,
    find_tracks,
)
from stkzoo.evaluation.benchmark.ai_times import RaceTimes, check_race_times, load_ai_times
from stkzoo.evaluation.benchmark.races import (
    DECIDED_SETTINGS,
    FIGURES,
    FORMS,
    BenchmarkForm,
    BenchmarkRace,
    FigureKind,
    FloatArray,
    RaceGroup,
    RaceOutcome,
    direction_name,
    find_group,
    group_races,
    make_races,
    steps_within,
)
from stkzoo.evaluation.statistics import CONFIDENCE, DRAWS, resampled_medians
from stkzoo.race.document import Document
from stkzoo.race.settings import RaceSettings

#: Time limit of a race, as a multiple of the AI's median time.
LIMIT = 3.0
_MAX_SEEDS = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchmarkPlan(BatchPlan):
    """The plan of a benchmark. It determines the races.

    Attributes:
        agents: the agent to measure.
        split: the tracks as the user named them.
        directions: ``False`` for forward, ``True`` for reversed.
        forms: names of race forms (:class:`~stkzoo.evaluation.BenchmarkForm`).
        seeds: number of races for each track, direction, form and end of the grid.
        limit: time limit of a race, as a multiple of the AI's median time.
        ai_times: the AI's median times [s], by track and by ``"forward"`` or ``"reversed"``.
        ai_races: the finish times behind these medians, as in ``AiTime.races``; empty if they are
            unknown.
    """

    kind: ClassVar[str] = "benchmark-plan"
    noun: ClassVar[str] = "benchmark"
    resume_command: ClassVar[str] = "stkzoo benchmark AGENT --output {folder}"
    decided: ClassVar[tuple[str, ...]] = DECIDED_SETTINGS
    changeable: ClassVar[tuple[str, ...]] = ("split", "ai_races")
    #: Whether rivals can be drivers of a population.
    has_population: ClassVar[bool] = False

    agents: Annotated[tuple[BatchAgent, ...], Meta(min_length=1, max_length=1)]
    split: str
    directions: Annotated[tuple[bool, ...], Meta(min_length=1, max_length=2)]
    forms: Annotated[tuple[str, ...], Meta(min_length=1, max_length=400)]
    seeds: int
    ai_times: Mapping[str, Mapping[str, Annotated[float, Meta(gt=0, le=1e5)]]]
    limit: Annotated[float, Meta(gt=0, le=1000)] = LIMIT
    ai_races: Mapping[str, Mapping[str, RaceTimes]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_whole("seeds", self.seeds, 1, _MAX_SEEDS)
        for form in self._forms():
            if form.has_population and not self.has_population:
                raise ConfigError(
                    f"race form {form.name!r} has karts of a population (B), which only tasks of "
                    "`stkzoo suite` have; expected A for each kart of the game's AI"
                )
        ends = sum(len(form.ends) for form in self._forms())
        check_num_races("benchmark", len(self.tracks) * len(self.directions) * ends * self.seeds)
        for track, reverse in itertools.product(self.tracks, self.directions):
            if direction_name(reverse) not in self.ai_times.get(track, {}):
                raise ConfigError(f"ai_times has no {track} ({direction_name(reverse)})")
        for races in itertools.chain(*(ways.values() for ways in self.ai_races.values())):
            check_race_times(races)

    def races(self) -> tuple[BenchmarkRace, ...]:
        """Returns all races of the benchmark."""
        return make_races(self.tracks, self.directions, self._forms(), self.seeds)

    def _forms(self) -> tuple[BenchmarkForm, ...]:
        return tuple(map(BenchmarkForm.of, self.forms))

    def ai_time(self, track: str, reverse: bool) -> float:
        """Returns the AI's median time on a track in a direction [s]."""
        return self.ai_times[track][direction_name(reverse)]

    def redrawn_ai_times(self) -> dict[tuple[str, bool], FloatArray]:
        """Returns resampled median times of the AI, ``(DRAWS,)`` by track and direction [s].

        Where the finish times are unknown, all draws are the median.
        """
        generator, times = np.random.default_rng(0), {}
        for track, reverse in itertools.product(self.tracks, self.directions):
            races = self.ai_races.get(track, {}).get(direction_name(reverse), ())
            times[track, reverse] = (
                resampled_medians(races, generator)
                if races
                else np.full(DRAWS, self.ai_time(track, reverse))
            )
        return times


def benchmark_orders(plan: BenchmarkPlan) -> list[RaceOrder]:
    """Returns the orders of all races of a benchmark."""
    return [benchmark_order(plan, race) for race in plan.races()]


def benchmark_order(plan: BenchmarkPlan, race: BenchmarkRace) -> RaceOrder:
    """Returns the order of a race of a benchmark."""
    karts = race.lineup.agent_karts(race.end)
    settings = replace(
        plan.settings,
        track=race.track,
        reverse=race.reverse,
        seed=race.seed,
        max_steps=steps_within(plan.limit * plan.ai_time(race.track, race.reverse)),
    )
    drivers = (plan.agent.text if kart in karts else "ai" for kart in range(len(race.form)))
    return RaceOrder(race.number, tuple(drivers), settings, karts)


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
        agent: the agent to measure: the name of a driver, the path of a folder or zip, or a module;
            append ``@:Name`` to rename it.
        split: name of a split (:data:`stkzoo.tracks.SPLITS`), or names of tracks.
        difficulty: level of the game's AI, 0 to 3.
        forms: race forms; ``"PAAAA"`` means one kart of the agent and four of the AI.
        seeds: number of races for each track, direction, form and end of the grid.
        reverse: the directions: ``False`` for forward, ``True`` for reversed.
        ai_times: a file with the AI's times; by default, the file that comes with stkzoo.
        settings: settings of every race. The benchmark itself sets the fields in
            ``BenchmarkPlan.decided``.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that replace those of
            ``settings``.

    Raises:
        ConfigError: an argument is invalid, or the agent or a track does not exist.
        AssetError: the game's data is missing.
    """
    chosen = replace(
        batch_settings(settings, changes, BenchmarkPlan.decided),
        track=None,
        laps=1,
        mode=NORMAL,
        kart=None,
        difficulty=difficulty,
        max_steps=None,
        max_steps_after_first=None,
        karts_finished=None,
    )
    tracks, directions = find_tracks(split, chosen), check_directions(reverse)
    names = (forms,) if isinstance(forms, str) else tuple(forms)
    if not names or len(set(names)) < len(names):
        raise ConfigError(
            f"forms is {names}, expected different race forms, such as {', '.join(FORMS)}"
        )
    times = load_ai_times(ai_times)
    measured = {
        track: {direction_name(way): times.of(track, way, difficulty) for way in directions}
        for track in tracks
    }
    return BenchmarkPlan(
        agents=find_agents([agent], chosen),
        split=split if isinstance(split, str) else " ".join(split),
        tracks=tracks,
        directions=directions,
        forms=names,
        seeds=seeds,
        ai_times={
            track: {way: time.median for way, time in of_track.items()}
            for track, of_track in measured.items()
        },
        ai_races={
            track: {way: time.races for way, time in of_track.items()}
            for track, of_track in measured.items()
        },
        settings=chosen,
    )


@dataclass(frozen=True)
class BenchmarkResult(Document):
    """The result of a benchmark.

    Attributes:
        plan: the benchmark.
        races: the races that have been run.
        sandboxes: sandboxes of the agents from files in these races.
        protections: protections that applied in all races with agents from files
            (:func:`stkzoo.drivers.sandbox.protections`).
    """

    # docs/schemas/benchmark-result.schema.json
    kind: ClassVar[str] = "benchmark-result"
    origin: ClassVar[str] = "the --output of `stkzoo benchmark`, or its result.json"
    rows: ClassVar[str] = "races"
    max_bytes: ClassVar[int] = MAX_RESULT_BYTES

    plan: BenchmarkPlan
    races: tuple[RaceOutcome, ...]
    sandboxes: tuple[str, ...] = field(compare=False, default=())
    protections: tuple[str, ...] = field(compare=False, default=())

    def __post_init__(self) -> None:
        planned = {race.number: (*race.key, race.seed) for race in self.plan.races()}
        for race in self.races:
            actual, expected = (*race.key, race.seed), planned.get(race.number)
            if actual != expected:
                raise ConfigError(
                    f"race {race.number} of the benchmark result is {actual}, expected {expected}; "
                    "another version of stkzoo wrote it"
                )

    @property
    def label(self) -> str:
        """Name of the agent."""
        return self.plan.agent.label

    @property
    def is_complete(self) -> bool:
        """Whether all races have been run."""
        return len(self.races) == len(self.plan.races())

    @property
    def errors(self) -> int:
        """Total number of failures of the agent."""
        return sum(kart.errors for race in self.races for kart in race.karts)

    @cached_property
    def groups(self) -> tuple[RaceGroup, ...]:
        """The metrics of all races and of groups of races."""
        return group_races(self.races, self.figure_kinds())

    def figure_kinds(self) -> tuple[FigureKind, ...]:
        """Returns the metrics, with the time ratio for resampled median times of the AI."""
        ai_times, limit = self.plan.redrawn_ai_times(), self.plan.limit

        def redrawn(race: RaceOutcome) -> FloatArray:
            return race.time_ratios(ai_times[race.track, race.reverse], limit)

        return tuple(
            replace(metric, redrawn=redrawn) if metric.name == "time_ratio" else metric
            for metric in FIGURES
        )

    def group(self, by: str = "all", name: str = "") -> RaceGroup:
        """Returns the metrics of a group of races.

        Args:
            by: what the races have in common, as in :attr:`RaceGroup.by`.
            name: name of the group, as in :attr:`RaceGroup.name`.

        Raises:
            KeyError: there is no such group.
        """
        return find_group(self.groups, by, name)

    def to_dict(self) -> dict[str, Any]:
        """Returns the result as JSON values."""
        return {
            "agent": self.label,
            "is_complete": self.is_complete,
            "interval": {"kind": "bootstrap over races", "confidence": CONFIDENCE},
            "groups": [asdict(group) for group in self.groups],
            **Document.to_dict(self),
        }
