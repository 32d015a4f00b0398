"""Reports of training runs in the suite: scores, comparisons and compute, with intervals."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from stkzoo._os import make_folder, write_text
from stkzoo.errors import ConfigError
from stkzoo.evaluation.plotting import require_matplotlib
from stkzoo.evaluation.statistics import CONFIDENCE, DRAWS
from stkzoo.evaluation.templates import render, require_jinja2
from stkzoo.suite.report import statistics
from stkzoo.suite.report.document import (
    NORMALIZED,
    AlgorithmReport,
    Band,
    Improvement,
    SuiteReport,
    TaskReport,
)
from stkzoo.suite.report.figures import draw_figures
from stkzoo.suite.report.results import DIRECTIONS, LearningCurve, SuiteRun, load_runs
from stkzoo.suite.report.statistics import FloatArray, ScoreTable, estimate, estimate_curve
from stkzoo.suite.scores import load_baselines, scale_ends
from stkzoo.suite.tasks import SUITE, TASKS, TIME_RATIO, find_task

_NUM_POINTS, _NUM_STEPS = 100, 50
_SECONDS_PER_HOUR = 3600.0
#: Names of MARL-eval's metrics by fields of :class:`~stkzoo.suite.report.results.LearningCurve`.
_METRICS = {"returns": "return", "finished": "finished", "position": "position"}
#: Captions of the figures, by name.
CAPTIONS = {
    "learning_curves": "Mean return of the training races. Bands contain all runs.",
    "scores": "Interquartile mean on the test tracks, with 95% intervals.",
    "profiles": "Share of runs, tracks and directions with a score above each value, with 95% "
    "bands.",
    "improvement": "Probability that a run of the first algorithm is better than one of the "
    "second on a track and direction, with 95% intervals.",
}
#: The runs of each algorithm in a task, in the order of their seeds.
_Groups = Mapping[str, Sequence[SuiteRun]]


# ------------------------------------------------------------------ the numbers


def make_report(runs: Sequence[SuiteRun]) -> SuiteReport:
    """Returns the report of training runs.

    Args:
        runs: the runs, as :func:`~stkzoo.suite.report.results.load_runs` returns them.
    """
    groups: dict[str, dict[str, list[SuiteRun]]] = {task: {} for task in TASKS}
    versions: dict[str, set[str]] = {}
    for run in runs:
        groups[run.task].setdefault(run.algorithm, []).append(run)
        for name, version in run.versions.items():
            versions.setdefault(name, set()).add(version)
    return SuiteReport(
        SUITE,
        CONFIDENCE,
        DRAWS,
        tuple(_task_report(task, of_task) for task, of_task in groups.items() if of_task),
        {name: tuple(sorted(of_name)) for name, of_name in sorted(versions.items())},
    )


def _task_report(name: str, groups: _Groups) -> TaskReport:
    task = find_task(name)
    tables = {algorithm: _table(runs) for algorithm, runs in groups.items()}
    thresholds = _thresholds([*tables.values()])
    return TaskReport(
        name,
        task.digest,
        task.metric,
        NORMALIZED if load_baselines().has(name) else task.metric,
        next(iter(groups.values()))[0].budget,
        tuple(_algorithm_report(runs, thresholds) for runs in groups.values()),
        tuple(
            Improvement(one, two, estimate(statistics.improvement, tables[one], tables[two]))
            for one, two in itertools.combinations(tables, 2)
        ),
    )


def _algorithm_report(runs: Sequence[SuiteRun], thresholds: FloatArray) -> AlgorithmReport:
    test = _table(runs)
    profile = estimate_curve(statistics.performance_profile(thresholds), test)
    return AlgorithmReport(
        runs[0].algorithm,
        tuple(run.seed for run in runs),
        estimate(statistics.mean, _table(runs, is_raw=True)),
        estimate(statistics.mean, _table(runs, "train", is_raw=True)),
        estimate(statistics.interquartile_mean, test),
        estimate(statistics.gap, _table(runs, "train"), test),
        Band.of(thresholds, *profile),
        _returns(runs),
        fmean(run.kart_steps for run in runs),
        fmean(run.training_seconds for run in runs) / _SECONDS_PER_HOUR,
        fmean(run.evaluation_seconds for run in runs) / _SECONDS_PER_HOUR,
        tuple(sorted({run.cores for run in runs})),
    )


def _table(runs: Sequence[SuiteRun], split: str = "test", *, is_raw: bool = False) -> ScoreTable:
    """Returns the scores on a split's tracks: the metric itself, or on the task's scale."""
    task = find_task(runs[0].task)
    tracks = task.test_tracks if split == "test" else task.train_tracks
    values = np.stack([getattr(run, split).by_column(tracks) for run in runs])
    if not is_raw:
        zero, one = scale_ends(task.name)
        values = (values - zero) / (one - zero)
    return ScoreTable(values, runs[0].algorithm, tracks, len(DIRECTIONS))


def _thresholds(tables: Sequence[ScoreTable]) -> FloatArray:
    values = np.concatenate([table.scores.ravel() for table in tables])
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


# ------------------------------------------------------------------ the files


def report_sections(report: SuiteReport, figures: Mapping[str, Path]) -> str:
    """Returns all tables and figures as Markdown, with headings of level 2.

    Args:
        report: the report.
        figures: file of each figure by name, relative to the page.
    """
    return render(
        Path(__file__).with_name("sections.md.jinja"),
        report=report,
        figures=figures,
        captions=CAPTIONS,
        comparisons=[(task.task, pair) for task in report.tasks for pair in task.improvements],
        normalized=NORMALIZED,
        time_ratio=TIME_RATIO,
    ).strip()


def marl_eval_json(runs: Sequence[SuiteRun]) -> str:
    """Returns runs as JSON text for MARL-eval: environment, task, algorithm, run, step, metrics.

    MARL-eval (Gorsane et al., 2022, https://github.com/instadeepai/marl-eval) requires the same
    metrics in all steps and in the absolute metrics of an environment. Training and evaluation
    measure different things, so they are two environments:

    - ``stkzoo-suite-1`` has one step, the end of the training, with the score of each race on the
      test tracks, on the scale of the task;
    - ``stkzoo-suite-1-training`` has the learning curve, at equal distances.

    It also requires the same algorithms and seeds in all tasks.

    Args:
        runs: the runs.
    """
    environments: dict[str, Any] = {SUITE: {}, f"{SUITE}-training": {}}
    for run in runs:
        zero, one = scale_ends(run.task)
        score = {"score": [(race.value - zero) / (one - zero) for race in run.test.races]}
        curve = _curve_steps(run.curve)
        last = {name: value for name, value in curve[-1].items() if name != "step_count"}
        ends = [{"step_count": run.kart_steps, **score}]
        parts = ((ends, score), (curve, last))
        for tasks, (steps, absolute) in zip(environments.values(), parts, strict=True):
            seeds = tasks.setdefault(run.task, {}).setdefault(run.algorithm, {})
            numbered = {f"step_{number}": step for number, step in enumerate(steps)}
            seeds[f"seed_{run.seed}"] = {**numbered, "absolute_metrics": absolute}
    return json.dumps(environments, allow_nan=False, separators=(",", ":")) + "\n"


def _curve_steps(curve: LearningCurve) -> list[dict[str, Any]]:
    """Returns the metrics at equal distances, from the first race that ended."""
    known = [n for n, value in enumerate(curve.returns) if value is not None] or [0]
    at = np.array([curve.kart_steps[n] for n in known], float)
    counts = np.linspace(at[0], at[-1], _NUM_STEPS)
    steps: list[dict[str, Any]] = [{"step_count": round(count)} for count in counts]
    for field, name in _METRICS.items():
        values = [getattr(curve, field)[n] for n in known]
        has_values = None not in values
        at_counts = np.interp(counts, at, values) if has_values else counts
        for step, value in zip(steps, at_counts.tolist(), strict=True):
            step[name] = [round(value, 6)] if has_values else []
    return steps


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
    if os.path.realpath(folder) in map(os.path.realpath, places):
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
    versions = ", ".join(f"{name} {' and '.join(of)}" for name, of in report.versions.items())
    head = f"# Report on {report.suite}\n\nVersions: {versions}."
    write_text(folder / "report.json", report.to_json() + "\n")
    write_text(folder / "marl_eval.json", marl_eval_json(runs))
    write_text(folder / "report.md", f"{head}\n\n{report_sections(report, figures)}\n")
    return report
