"""Reports of training runs in the suite: scores, comparisons and compute, with intervals."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

import numpy as np

from stkzoo._os import make_folder, write_text
from stkzoo.errors import ConfigError
from stkzoo.evaluation.plotting import require_matplotlib
from stkzoo.evaluation.statistics import CONFIDENCE, DRAWS
from stkzoo.evaluation.templates import require_jinja2
from stkzoo.suite.report.document import (
    NORMALIZED,
    AlgorithmReport,
    Band,
    Improvement,
    OverallReport,
    OverallScores,
    RunKey,
    SuiteReport,
    TaskReport,
)
from stkzoo.suite.report.figures import draw_figures
from stkzoo.suite.report.marl_eval import marl_eval_json
from stkzoo.suite.report.results import DIRECTIONS, SuiteRun, load_runs
from stkzoo.suite.report.statistics import (
    FloatArray,
    ScoreTable,
    estimate,
    estimate_curve,
    gap,
    improvement,
    interquartile_mean,
    mean,
    performance_profile,
)
from stkzoo.suite.report.tables import report_page
from stkzoo.suite.scores import load_baselines, scale_ends
from stkzoo.suite.tasks import SUITE, TASKS, can_learn, find_task

_NUM_POINTS = 100
_SECONDS_PER_HOUR = 3600.0


# ------------------------------------------------------------------ scores of runs


@dataclass(frozen=True, slots=True)
class _RunGroup:
    """The runs of an algorithm in a task, in the order of their seeds."""

    runs: tuple[SuiteRun, ...]

    @property
    def seeds(self) -> tuple[int, ...]:
        return tuple(run.seed for run in self.runs)

    def only(self, seeds: Iterable[int]) -> _RunGroup:
        return _RunGroup(tuple(run for run in self.runs if run.seed in set(seeds)))

    def table(self, split: str = "test", *, is_raw: bool = False) -> ScoreTable:
        """Returns the scores on a split's tracks: the metric itself, or on the task's scale."""
        run = self.runs[0]
        task = find_task(run.task)
        tracks = task.test_tracks if split == "test" else task.train_tracks
        values = np.stack([getattr(run, split).by_column(tracks) for run in self.runs])
        if not is_raw:
            zero, one = scale_ends(task.name)
            values = (values - zero) / (one - zero)
        return ScoreTable(values, (task.name, run.algorithm), tracks, len(DIRECTIONS))


def _thresholds(groups: Sequence[_RunGroup]) -> FloatArray:
    values = np.concatenate([group.table().scores.ravel() for group in groups])
    low, high = np.floor(values.min() * 10 - 0.5) / 10, np.ceil(values.max() * 10 + 0.5) / 10
    return np.linspace(low, high, _NUM_POINTS + 1)


def _returns(runs: Sequence[SuiteRun]) -> Band | None:
    """Returns the mean of the learning curves where all runs have values; ``None`` without any."""
    curves = []
    for run in runs:
        pairs = zip(run.curve.kart_steps, run.curve.returns, strict=True)
        known = [(steps, value) for steps, value in pairs if value is not None]
        if not known:
            return None
        curves.append(np.array(known, float).T)
    start, end = max(steps[0] for steps, _ in curves), min(steps[-1] for steps, _ in curves)
    x = np.linspace(start, max(start, end), _NUM_POINTS)
    values = np.stack([np.interp(x, steps, returns) for steps, returns in curves])
    if len(runs) == 1:
        return Band.of(x, values[0], None, None)
    return Band.of(x, values.mean(axis=0), values.min(axis=0), values.max(axis=0))


# ------------------------------------------------------------------ the report


def make_report(runs: Sequence[SuiteRun], expected: Iterable[RunKey] | None = None) -> SuiteReport:
    """Returns the report of training runs.

    Args:
        runs: the runs, as :func:`~stkzoo.suite.report.results.load_runs` returns them.
        expected: task, algorithm and seed of the runs that should be there; by default, each
            combination of those that occur, except tasks that an algorithm cannot learn.
    """
    keys = {(run.task, run.algorithm, run.seed) for run in runs}
    if expected is None:
        every = itertools.product(*(sorted(set(values)) for values in zip(*keys, strict=True)))
        expected = [key for key in every if can_learn(key[1], find_task(key[0]))]
    groups: dict[str, dict[str, _RunGroup]] = {}
    for task in TASKS:
        for run in (run for run in runs if run.task == task):
            of_task = groups.setdefault(task, {})
            of_task[run.algorithm] = _RunGroup(
                (*of_task.get(run.algorithm, _RunGroup(())).runs, run)
            )
    versions: dict[str, set[str]] = {}
    for name, version in (item for run in runs for item in run.versions.items()):
        versions.setdefault(name, set()).add(version)
    return SuiteReport(
        SUITE,
        CONFIDENCE,
        DRAWS,
        tuple(_task_report(task, of_task) for task, of_task in groups.items()),
        _overall(groups),
        tuple(key for key in expected if key not in keys),
        {name: tuple(sorted(found)) for name, found in sorted(versions.items())},
    )


def _task_report(name: str, groups: dict[str, _RunGroup]) -> TaskReport:
    task = find_task(name)
    thresholds = _thresholds([*groups.values()])
    return TaskReport(
        name,
        task.digest,
        task.metric,
        NORMALIZED if load_baselines().has(name) else task.metric,
        next(iter(groups.values())).runs[0].budget,
        tuple(_algorithm_report(of_task, thresholds) for of_task in groups.values()),
        tuple(
            Improvement(one, two, estimate(improvement, first.table(), second.table()))
            for (one, first), (two, second) in itertools.combinations(groups.items(), 2)
        ),
    )


def _algorithm_report(group: _RunGroup, thresholds: FloatArray) -> AlgorithmReport:
    runs, test = group.runs, group.table()
    profile = estimate_curve(performance_profile(thresholds), test)
    return AlgorithmReport(
        runs[0].algorithm,
        group.seeds,
        estimate(mean, group.table(is_raw=True)),
        estimate(mean, group.table("train", is_raw=True)),
        estimate(interquartile_mean, test),
        estimate(gap, group.table("train"), test),
        Band.of(thresholds, *profile),
        _returns(runs),
        fmean(run.kart_steps for run in runs),
        fmean(run.training_seconds for run in runs) / _SECONDS_PER_HOUR,
        fmean(run.evaluation_seconds for run in runs) / _SECONDS_PER_HOUR,
        tuple(sorted({run.cores for run in runs})),
    )


def _overall(groups: dict[str, dict[str, _RunGroup]]) -> OverallReport | None:
    """Returns the report of all tasks with baselines in which all algorithms have runs."""
    algorithms = sorted({name for of_task in groups.values() for name in of_task})
    tasks = [
        task for task in groups if load_baselines().has(task) and set(groups[task]) >= {*algorithms}
    ]
    if len(tasks) < 2:
        return None
    shared: dict[str, list[_RunGroup]] = {}
    for name in algorithms:
        of_algorithm = [groups[task][name] for task in tasks]
        seeds = set.intersection(*(set(group.seeds) for group in of_algorithm))
        if seeds:
            shared[name] = [group.only(seeds) for group in of_algorithm]
    if not shared:
        return None
    thresholds = _thresholds([*itertools.chain(*shared.values())])
    profile_of = performance_profile(thresholds)
    tables = {name: [group.table() for group in of_name] for name, of_name in shared.items()}
    return OverallReport(
        tuple(tasks),
        tuple(
            OverallScores(
                name,
                shared[name][0].seeds,
                estimate(interquartile_mean, *of_name),
                Band.of(thresholds, *estimate_curve(profile_of, *of_name)),
            )
            for name, of_name in tables.items()
        ),
        tuple(
            Improvement(
                one,
                two,
                estimate(improvement, *itertools.chain(*zip(first, second, strict=True))),
            )
            for (one, first), (two, second) in itertools.combinations(tables.items(), 2)
        ),
    )


def write_suite_report(
    paths: Iterable[str | os.PathLike[str]], output: str | os.PathLike[str]
) -> SuiteReport:
    """Writes the report of result files: numbers, tables and figures.

    The same results make the same files.

    Args:
        paths: result files, and folders of them.
        output: folder for ``report.json``, ``report.md``, ``marl_eval.json`` and the figures. It is
            created if needed.

    Returns:
        The report.

    Raises:
        ConfigError: a result is invalid, a library is missing, a file cannot be written, or
            ``output`` is one of the folders of results.
    """
    places, folder = tuple(map(Path, paths)), Path(output)
    if folder.resolve() in [place.resolve() for place in places]:
        raise ConfigError(
            f"{folder} has the results, and the next report would read this one as a result; "
            "choose another --output, such as a folder in it"
        )
    require_matplotlib("report")
    require_jinja2("report")
    runs = load_runs(places)
    report = make_report(runs)
    make_folder(folder, "report")
    figures = draw_figures(report, folder)
    write_text(folder / "report.json", report.to_json() + "\n")
    write_text(folder / "marl_eval.json", marl_eval_json(runs))
    write_text(folder / "report.md", report_page(report, figures))
    return report
