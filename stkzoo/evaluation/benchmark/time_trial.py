"""Time trials: an agent alone on each track, against the human world records."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from statistics import fmean
from typing import Any, ClassVar

from stkzoo._schema import Count, Positive, Whole
from stkzoo.config import TIME_TRIAL
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.agents import find_agents
from stkzoo.evaluation.batch.plan import RESULT_FILE, find_tracks
from stkzoo.evaluation.batch.run import BatchKind, RaceResults, RunOptions, written
from stkzoo.evaluation.benchmark.plan import AgentPlan, measured_settings
from stkzoo.evaluation.benchmark.races import FRONT, BenchmarkForm, BenchmarkRace, make_races
from stkzoo.evaluation.benchmark.result import AgentBatchResult, race_outcomes
from stkzoo.evaluation.plotting import BLUE, GRAY, INK, new_figure, save_figure, shorten, style_axes
from stkzoo.race.result import shared_protections
from stkzoo.race.settings import RaceSettings
from stkzoo.records import HUMAN_RECORDS, RECORD_DIFFICULTY, RECORD_KART, HumanRecord

#: A track counts as close to the record up to this multiple of the record.
CLOSE = 1.15
#: The agent drives alone.
_FORM = BenchmarkForm.of("P")


@dataclass(frozen=True, slots=True)
class TimeTrialRace:
    """The outcome of one time trial.

    Attributes:
        number: number of the race, from 0.
        track: name of the track.
        index: number of the race among those on this track, from 0.
        seed: seed of all random choices in the race; the same for every agent.
        status: why the race ended.
        time: finish time [s]; ``None`` if the kart did not finish.
        ratio: finish time as a multiple of the record, at most the time limit. A kart that did not
            finish counts with the time limit.
        laps: number of complete laps.
        rescues: number of times the kart was put back on the road; ``None`` if not counted.
        errors: number of failures of the agent.
    """

    number: Count
    track: str
    index: Count
    seed: Count
    status: str
    time: Positive | None
    ratio: Positive
    laps: Count
    rescues: Count | None
    errors: Count

    @property
    def key(self) -> tuple[str, bool, str, str, int]:
        """See :class:`~stkzoo.evaluation.BenchmarkRace`."""
        return self.track, False, _FORM.name, FRONT, self.index


@dataclass(frozen=True, slots=True)
class TrackTrial:
    """The outcome of all time trials on one track.

    Attributes:
        track: name of the track.
        laps: number of laps of a race.
        record: human world record [s].
        races: number of races.
        finished: number of races that the agent finished.
        time: mean finish time [s]; ``None`` if no race was finished.
        ratio: mean multiple of the record. A race that was not finished counts with the time limit.
    """

    track: str
    laps: Whole
    record: Positive
    races: Whole
    finished: Count
    time: Positive | None
    ratio: Positive


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeTrialPlan(AgentPlan):
    """The plan of time trials: a benchmark in which the agent drives alone, as in the records.

    Attributes:
        agents: the agent to measure.
        split: the tracks as the user named them.
        seeds: number of races on each track.
        limit: time limit of a race, as a multiple of the record.
        records: the human world record of each track.
    """

    type_name: ClassVar[str] = "time-trial-plan"
    resume_command: ClassVar[str] = "stkzoo benchmark AGENT --time-trial --output {folder}"

    records: Mapping[str, HumanRecord]

    def __post_init__(self) -> None:
        self.check_seeds(len(self.tracks))
        for track in self.tracks:
            if track not in self.records:
                raise ConfigError(f"{track} has no human record; leave it out of --track")

    def races(self) -> tuple[BenchmarkRace, ...]:
        """Returns all races."""
        return make_races(self.tracks, (False,), (_FORM,), self.seeds)

    def reference_time(self, track: str, _: bool = False) -> float:
        """Returns the record of a track [s]."""
        return self.records[track].seconds

    def laps(self, track: str) -> int:
        """Returns the number of laps of the record of a track."""
        return self.records[track].laps


def plan_time_trial(
    agent: str,
    *,
    split: str | Sequence[str] = "all",
    seeds: int = 1,
    settings: RaceSettings | None = None,
    **changes: Any,
) -> TimeTrialPlan:
    """Plans time trials under the conditions of the human world records.

    Args:
        agent: the agent to measure: the name of a driver, the path of a folder or zip, or a module;
            append ``@:Name`` to rename it.
        split: ``"test"``, ``"train"``, ``"all"``, or names of tracks.
        seeds: number of races on each track.
        settings: settings of every race. The time trials set the fields in
            ``TimeTrialPlan.decided``.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that replace those of
            ``settings``.

    Raises:
        ConfigError: an argument is invalid, the agent or a track does not exist, or a track has no
            record.
        AssetError: the game's data is missing.
    """
    conditions = {"kart": RECORD_KART, "difficulty": RECORD_DIFFICULTY, "reverse": False}
    chosen = measured_settings(settings, changes, mode=TIME_TRIAL, **conditions)
    tracks = find_tracks(split, chosen)
    return TimeTrialPlan(
        agents=find_agents([agent], chosen),
        split=split if isinstance(split, str) else " ".join(split),
        tracks=tracks,
        seeds=seeds,
        records={track: HUMAN_RECORDS[track] for track in tracks if track in HUMAN_RECORDS},
        settings=chosen,
    )


@dataclass(frozen=True)
class TimeTrialResult(AgentBatchResult):
    """The result of time trials.

    Attributes:
        plan: the time trials.
        races: the races that have been run.
        sandboxes: as in :class:`~stkzoo.evaluation.BenchmarkResult`.
        protections: as in :class:`~stkzoo.evaluation.BenchmarkResult`.
    """

    # docs/schemas/time-trial-result.schema.json
    type_name: ClassVar[str] = "time-trial-result"
    origin: ClassVar[str] = "the --output of `stkzoo benchmark --time-trial`, or its result.json"

    plan: TimeTrialPlan
    races: tuple[TimeTrialRace, ...]

    @cached_property
    def tracks(self) -> tuple[TrackTrial, ...]:
        """The outcome on each track that has been raced on."""
        of_track: dict[str, list[TimeTrialRace]] = {}
        for race in self.races:
            of_track.setdefault(race.track, []).append(race)
        return tuple(self._track(name, of_track[name]) for name in sorted(of_track))

    def _track(self, name: str, races: Sequence[TimeTrialRace]) -> TrackTrial:
        record = self.plan.records[name]
        times = [race.time for race in races if race.time is not None]
        return TrackTrial(
            track=name,
            laps=record.laps,
            record=record.seconds,
            races=len(races),
            finished=len(times),
            time=round(fmean(times), 3) if times else None,
            ratio=round(fmean(race.ratio for race in races), 4),
        )

    @property
    def mean_ratio(self) -> float | None:
        """Mean of the tracks' ratios; ``None`` without races."""
        return round(fmean(track.ratio for track in self.tracks), 4) if self.tracks else None

    @property
    def close(self) -> int:
        """Number of tracks on which the agent takes at most 1.15 times the record."""
        return sum(track.ratio <= CLOSE for track in self.tracks)

    @property
    def unfinished(self) -> tuple[str, ...]:
        """Tracks on which the agent did not finish every race."""
        return tuple(track.track for track in self.tracks if track.finished < track.races)

    def to_dict(self) -> dict[str, Any]:
        """Returns the result as JSON values."""
        return {
            "mean_ratio": self.mean_ratio,
            "close": {"limit": CLOSE, "tracks": self.close},
            "unfinished": self.unfinished,
            "tracks": [asdict(track) for track in self.tracks],
            **AgentBatchResult.to_dict(self),
        }


def summarize_time_trial(plan: TimeTrialPlan, results: RaceResults, _: Path) -> TimeTrialResult:
    """Returns the result of the races that have been run.

    Args:
        plan: the time trials.
        results: results of races by number.
    """
    races = []
    for race in race_outcomes(plan, results):
        (kart,), (row,) = race.karts, results[race.number].agents
        races.append(
            TimeTrialRace(
                number=race.number,
                track=race.track,
                index=race.index,
                seed=race.seed,
                status=race.status,
                time=kart.time,
                ratio=round(race.time_ratio, 5),
                laps=max(row.laps, 0),
                rescues=kart.rescues,
                errors=kart.errors,
            )
        )
    return TimeTrialResult(plan, tuple(races), *shared_protections(results.values()))


def plot_time_trial(result: TimeTrialResult, path: str | os.PathLike[str]) -> None:
    """Plots an agent's times as multiples of the human records to a file.

    Args:
        result: result of the agent.
        path: the file, which is written atomically; its suffix selects the format.

    Raises:
        ConfigError: matplotlib is not installed, or the file cannot be written.
    """
    tracks = sorted(result.tracks, key=lambda track: track.ratio)
    figure = new_figure(7, 1.4 + 0.24 * len(tracks))
    axes = figure.subplots()
    colors = [BLUE if track.finished == track.races else GRAY for track in tracks]
    bars = axes.barh(range(len(tracks)), [track.ratio for track in tracks], color=colors)
    labels = [f"{track.ratio:.2f}" for track in tracks]
    axes.bar_label(bars, labels, padding=3, fontsize=8, color=INK)
    axes.axvline(1.0, color=INK, linewidth=1)
    axes.set_yticks(range(len(tracks)), [track.track for track in tracks])
    axes.set_ylim(len(tracks) - 0.4, -0.6)
    who = shorten(result.label)
    style_axes(axes, f"{who}: time as a multiple of the human record; gray: unfinished")
    save_figure(figure, path)


TIME_TRIALS = BatchKind(
    TimeTrialPlan,
    summarize_time_trial,
    written(RESULT_FILE),
    plot_time_trial,
    "benchmark.png",
)


def run_time_trial(
    agent: str, *, output: str | os.PathLike[str], **options: Any
) -> TimeTrialResult:
    """Runs an agent's time trials, or resumes them if they were started in ``output``.

    Args:
        agent: the agent to measure; see :func:`~stkzoo.evaluation.plan_time_trial`.
        output: folder for the result of each race, ``result.json`` and ``benchmark.png``.
        options: ``jobs``, ``race_timeout``, ``on_race`` and ``plot``, as in
            :class:`~stkzoo.evaluation.RunOptions`; all others as for
            :func:`~stkzoo.evaluation.plan_time_trial`.

    Raises:
        ConfigError: an argument is invalid, a library is missing, or ``output`` contains another
            benchmark.
        AssetError: the game's data is missing.
        BatchError: some races could not be run.
    """
    run, plan = RunOptions.split(options)
    return TIME_TRIALS.run(plan_time_trial(agent, **plan), Path(output), run)


def load_time_trial(path: str | os.PathLike[str]) -> TimeTrialResult:
    """Returns the current result of time trials without running any race.

    Args:
        path: folder of the time trials, or a ``result.json``.

    Raises:
        ConfigError: there is no result, or a file is damaged.
    """
    return TIME_TRIALS.load(path, TimeTrialResult)
