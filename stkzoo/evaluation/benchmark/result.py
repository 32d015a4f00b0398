"""The result of a benchmark: its metrics, its plot, and its comparison with another one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from stkzoo.errors import ConfigError
from stkzoo.evaluation import plotting
from stkzoo.evaluation.batch.plan import MAX_RESULT_BYTES, RESULT_FILE, describe_differences
from stkzoo.evaluation.batch.run import BatchKind, RaceResults, RunOptions, written
from stkzoo.evaluation.benchmark.plan import BenchmarkPlan, plan_benchmark, plan_time_trial
from stkzoo.evaluation.benchmark.races import FIGURES, FigureKind, RaceGroup, RaceOutcome
from stkzoo.evaluation.statistics import CONFIDENCE
from stkzoo.race.document import Document
from stkzoo.race.result import shared_protections

#: Fraction of a row's height over which the agents are spread.
_SPREAD = 0.5


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
    type_name: ClassVar[str] = "benchmark-result"
    origin: ClassVar[str] = "the --output of `stkzoo benchmark`, or its result.json"
    rows: ClassVar[str] = "races"
    max_bytes: ClassVar[int] = MAX_RESULT_BYTES
    metrics: ClassVar[tuple[FigureKind, ...]] = FIGURES

    plan: BenchmarkPlan
    races: tuple[RaceOutcome, ...]
    sandboxes: tuple[str, ...] = field(compare=False, default=())
    protections: tuple[str, ...] = field(compare=False, default=())

    def __post_init__(self) -> None:
        planned = {race.number: (*race.key, race.seed) for race in self.plan.races()}
        title = self.type_name.replace("-", " ")
        for race in self.races:
            actual, expected = (*race.key, race.seed), planned.get(race.number)
            if actual != expected:
                raise ConfigError(
                    f"race {race.number} of the {title} is {actual}, expected {expected}; another "
                    "version of stkzoo wrote it"
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
        return sum(race.errors for race in self.races)

    @cached_property
    def groups(self) -> tuple[RaceGroup, ...]:
        """The metrics of all races and of groups of races."""
        return RaceGroup.all_of(self.races, self.metrics)

    def group(self, by: str = "all", name: str = "") -> RaceGroup:
        """Returns the metrics of a group of races.

        Args:
            by: what the races have in common, as in :attr:`RaceGroup.by`.
            name: name of the group, as in :attr:`RaceGroup.name`.

        Raises:
            KeyError: there is no such group.
        """
        return RaceGroup.find(self.groups, by, name)

    def to_dict(self) -> dict[str, Any]:
        """Returns the result as JSON values."""
        return {
            "interval": {"kind": "bootstrap over races", "confidence": CONFIDENCE},
            "groups": [asdict(group) for group in self.groups],
            "agent": self.label,
            "is_complete": self.is_complete,
            **Document.to_dict(self),
        }


def race_outcomes(plan: BenchmarkPlan, results: RaceResults) -> tuple[RaceOutcome, ...]:
    """Returns the outcomes of the races that have been run.

    Args:
        plan: the plan.
        results: results of races by number.
    """
    return tuple(
        RaceOutcome.of(
            race, results[race.number], plan.reference_time(race.track, race.reverse), plan.limit
        )
        for race in plan.races()
        if race.number in results
    )


def _result(plan: BenchmarkPlan, results: RaceResults, _: Path) -> BenchmarkResult:
    return BenchmarkResult(
        plan, race_outcomes(plan, results), *shared_protections(results.values())
    )


# ------------------------------------------------------------------ plots


def plot_benchmark(
    results: BenchmarkResult | Sequence[BenchmarkResult], path: str | os.PathLike[str]
) -> None:
    """Plots one or more results to a file, which is written atomically.

    Args:
        results: result of one agent, or results of several agents.
        path: the file; its suffix selects the format, such as ``.png`` or ``.svg``.

    Raises:
        ConfigError: matplotlib is not installed, or the file cannot be written.
    """
    drawn = list(results) if isinstance(results, Sequence) else [results]
    groups = [group for result in drawn for group in result.groups]
    rows = [
        (by, name)
        for by in ("all", "direction", "track")
        for name in dict.fromkeys(group.name for group in groups if group.by == by)
    ]
    chances = {group.name: group.chance for group in groups if group.by == "form"}
    contests = [("form", name) for name, chance in chances.items() if chance is not None]
    height = 1.9 + len(rows) * (0.2 + 0.12 * len(drawn))
    widths = (6, 4) if contests else (6,)
    figure = plotting.new_figure(sum(widths), height)
    times, *rest = figure.subplots(1, len(widths), width_ratios=widths, squeeze=False).flat
    _draw(times, drawn, rows, "time_ratio")
    times.axvline(1.0, color=plotting.GRAY, linewidth=1, linestyle="--", zorder=0)
    reference = "the human record" if drawn[0].plan.is_time_trial else "the AI's"
    plotting.style_axes(times, f"Time as a multiple of {reference}; less is better")
    for wins in rest:
        _draw(wins, drawn, contests, "win_rate", scale=100)
        for row, (_, name) in enumerate(contests):
            chance, ends = 100 * (chances[name] or 0.0), [row - 0.35, row + 0.35]
            wins.plot([chance, chance], ends, color=plotting.GRAY, linewidth=2, zorder=0)
        wins.set_xlim(-3, 103)
        plotting.style_axes(wins, "Races won [%]; the mark is chance")
    if len(drawn) > 1:
        handles = times.get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower center", ncols=3 * len(widths))
    figure.suptitle(_title(drawn), color=plotting.INK, fontsize=11)
    plotting.save_figure(figure, path)


def _draw(
    axes: Any,
    results: Sequence[BenchmarkResult],
    rows: Sequence[tuple[str, str]],
    figure: str,
    scale: float = 1,
) -> None:
    for number, result in enumerate(results):
        shift = _SPREAD * ((number + 0.5) / len(results) - 0.5)
        known = {(group.by, group.name): group.figures[figure] for group in result.groups}
        estimates = {row + shift: known.get(key) for row, key in enumerate(rows)}
        plotting.draw_intervals(
            axes,
            {row: estimate for row, estimate in estimates.items() if estimate is not None},
            scale=scale,
            color=plotting.PALETTE[number % len(plotting.PALETTE)],
            label=plotting.shorten(result.label),
        )
    axes.set_yticks(range(len(rows)), [name or "all races" for _, name in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)


def _title(results: Sequence[BenchmarkResult]) -> str:
    plan = results[0].plan
    who = results[0].label if len(results) == 1 else f"{len(results)} agents"
    races = max(len(result.races) for result in results)
    return f"{who} on {plan.split}, difficulty {plan.settings.difficulty}; races: {races:,}"


# ------------------------------------------------------------------ runs

BENCHMARK = BatchKind(BenchmarkPlan, _result, written(RESULT_FILE), plot_benchmark, "benchmark.png")


def run_benchmark(agent: str, *, output: str | os.PathLike[str], **options: Any) -> BenchmarkResult:
    """Runs a benchmark of an agent, or resumes it if it was started in ``output``.

    Args:
        agent: the agent to measure; see :func:`~stkzoo.evaluation.plan_benchmark`.
        output: folder for the result of each race, ``result.json`` and ``benchmark.png``.
        options: ``jobs``, ``race_timeout``, ``on_race`` and ``plot``, as in
            :class:`~stkzoo.evaluation.RunOptions`; all others as for
            :func:`~stkzoo.evaluation.plan_benchmark`.

    Raises:
        ConfigError: an argument is invalid, a library is missing, or ``output`` contains another
            benchmark.
        AssetError: the game's data is missing.
        BatchError: some races could not be run.
    """
    run, plan = RunOptions.split(options)
    return BENCHMARK.run(plan_benchmark(agent, **plan), Path(output), run)


def run_time_trial(
    agent: str, *, output: str | os.PathLike[str], **options: Any
) -> BenchmarkResult:
    """Runs an agent's time trials, or resumes them if they were started in ``output``.

    Args:
        agent: the agent to measure; see :func:`~stkzoo.evaluation.plan_benchmark`.
        output: folder, as for :func:`run_benchmark`.
        options: as for :func:`run_benchmark`, but with those of
            :func:`~stkzoo.evaluation.plan_time_trial`.

    Raises:
        ConfigError: see :func:`run_benchmark`.
        AssetError: the game's data is missing.
        BatchError: some races could not be run.
    """
    run, plan = RunOptions.split(options)
    return BENCHMARK.run(plan_time_trial(agent, **plan), Path(output), run)


def load_benchmark(path: str | os.PathLike[str]) -> BenchmarkResult:
    """Returns the current result of a benchmark without running any race.

    Args:
        path: folder of the benchmark, or a ``result.json``.

    Raises:
        ConfigError: there is no result, or a file is damaged.
    """
    return BENCHMARK.load(path, BenchmarkResult)


# ------------------------------------------------------------------ comparisons


@dataclass(frozen=True, slots=True)
class Comparison(Document):
    """The differences between the results of two agents.

    Attributes:
        first: name of the first agent.
        second: name of the second agent.
        differences: differences over all races and over groups of races: metrics of the first
            agent minus those of the second.
    """

    type_name: ClassVar[str] = "benchmark-comparison"
    origin: ClassVar[str] = "the output of `stkzoo benchmark --compare --json`"

    first: str
    second: str
    differences: tuple[RaceGroup, ...]

    def difference(self, by: str = "all", name: str = "") -> RaceGroup:
        """Returns the differences in a group of races.

        Args:
            by: what the races have in common, as in :attr:`RaceGroup.by`.
            name: name of the group, as in :attr:`RaceGroup.name`.

        Raises:
            KeyError: there is no such group.
        """
        return RaceGroup.find(self.differences, by, name)

    def to_dict(self) -> dict[str, Any]:
        """Returns the comparison as JSON values."""
        interval = {"kind": "bootstrap over pairs of races", "confidence": CONFIDENCE}
        return {"interval": interval, **Document.to_dict(self)}


def compare(first: BenchmarkResult, second: BenchmarkResult) -> Comparison:
    """Compares two agents in the races that both have driven.

    Each race is paired with the other agent's race with the same track, direction, form, end of
    the grid and seed, so the effects of these conditions cancel out.

    Args:
        first: result of the first agent.
        second: result of the second agent.

    Raises:
        ConfigError: the agents raced under different conditions, or have no race in common.
    """
    if differing := _differing_conditions(first.plan, second.plan):
        raise ConfigError(
            f"{first.label} and {second.label} raced under different conditions: "
            f"{'; '.join(differing)}. Run the benchmark again for one of them"
        )
    others = {race.key: race for race in second.races}
    shared = [race for race in first.races if race.key in others]
    if not shared:
        raise ConfigError(
            f"{first.label} and {second.label} have no race in common; give both the same tracks, "
            "directions and forms"
        )

    def minus(metric: FigureKind) -> FigureKind:
        def difference(race: RaceOutcome) -> float | None:
            one, two = metric.of(race), metric.of(others[race.key])
            return None if one is None or two is None else one - two

        return FigureKind(
            metric.name,
            difference,
            metric.bounds and (-metric.bounds[1], metric.bounds[1]),
        )

    groups = RaceGroup.all_of(shared, [minus(metric) for metric in first.metrics])
    return Comparison(first.label, second.label, groups)


def _differing_conditions(first: BenchmarkPlan, second: BenchmarkPlan) -> list[str]:
    """Describes the conditions whose difference makes two results incomparable."""
    one, two = _conditions(first), _conditions(second)
    shared = one.keys() & two.keys()  # of the AI's times, those on tracks of both
    return describe_differences(
        {name: one[name] for name in shared}, {name: two[name] for name in shared}
    )


def _conditions(plan: BenchmarkPlan) -> dict[str, Any]:
    times = {
        f"the AI's time on {track} ({direction})": time
        for track, of_track in plan.ai_times.items()
        for direction, time in of_track.items()
    }
    return times | {
        "engine": plan.versions.get("pystk2"),
        "mode": plan.settings.mode,
        "difficulty": plan.settings.difficulty,
        "limit": plan.limit,
    }
