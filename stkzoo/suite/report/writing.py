"""Reports of training runs in the suite: scores, comparisons and power, with intervals."""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from stkzoo._os import make_folder, write_text
from stkzoo.evaluation.plotting import require_matplotlib
from stkzoo.evaluation.statistics import CONFIDENCE, DRAWS, Estimate
from stkzoo.evaluation.templates import render, require_jinja2
from stkzoo.suite.about import LEARNED
from stkzoo.suite.report import document, statistics
from stkzoo.suite.report.figures import draw_figures
from stkzoo.suite.report.runs import DIRECTIONS, LearningCurve, SuiteRun, load_runs
from stkzoo.suite.report.statistics import (
    FloatArray,
    ScoreTable,
    estimate,
    estimate_t,
    runs_needed,
)
from stkzoo.suite.scores import load_baselines, scale_ends
from stkzoo.suite.tasks import SUITE, TASKS, TIME_RATIO

_NUM_POINTS, _NUM_STEPS = 100, 50
_SECONDS_PER_HOUR = 3600.0
#: Differences of the metric for which a report says how many runs detect them.
_DIFFERENCES = (0.05, 0.1)
#: Names of MARL-eval's metrics by fields of :class:`~stkzoo.suite.report.runs.LearningCurve`.
_METRICS = {"returns": "return", "finished": "finished", "position": "position"}


# ------------------------------------------------------------------ the numbers


def make_report(runs: Sequence[SuiteRun]) -> document.SuiteReport:
    """Returns the report of training runs.

    Args:
        runs: the runs, as :func:`~stkzoo.suite.report.runs.load_runs` returns them.
    """
    tasks: dict[str, list[SuiteRun]] = {task: [] for task in TASKS}
    versions: dict[str, set[str]] = {}
    for run in runs:
        tasks.setdefault(run.task.name, []).append(run)
        for name, version in run.test.entry.plan.versions.items():
            versions.setdefault(name, set()).add(version)
    return document.SuiteReport(
        SUITE,
        CONFIDENCE,
        DRAWS,
        tuple(_task_report(of_task) for of_task in tasks.values() if of_task),
        {name: tuple(sorted(of_name)) for name, of_name in sorted(versions.items())},
    )


def _task_report(runs: Sequence[SuiteRun]) -> document.TaskReport:
    task, fresh = runs[0].task, runs[0].test.entry.plan.fresh
    groups: dict[tuple[str, str, str], list[SuiteRun]] = {}
    for run in runs:
        groups.setdefault((run.agent_class, *run.name), []).append(run)
    reports = [_algorithm_report(of_algorithm) for of_algorithm in groups.values()]
    tables = [_table(of_algorithm) for of_algorithm in groups.values()]
    pairs = itertools.combinations(zip(reports, tables, strict=True), 2)
    return document.TaskReport(
        task.name,
        task.digest,
        fresh,
        task.metric,
        document.NORMALIZED if load_baselines().has(task.name) and not fresh else task.metric,
        tuple(reports),
        tuple(
            document.Improvement(
                one.name, two.name, estimate(statistics.improvement, first, second)
            )
            for (one, first), (two, second) in pairs
            if one.agent_class == two.agent_class
        ),
        _power(groups.values()),
    )


def _algorithm_report(runs: Sequence[SuiteRun]) -> document.AlgorithmReport:
    algorithm, variant = runs[0].name
    raw, test, train = _table(runs, is_raw=True), _table(runs), _train_tables(runs)
    curves = [run.curve for run in runs if run.curve is not None]
    steps = [run.kart_steps for run in runs if run.kart_steps is not None]
    parts = [run.test.parts() for run in runs]
    return document.AlgorithmReport(
        algorithm,
        variant,
        runs[0].agent_class,
        len(runs),
        tuple(run.seed for run in runs if run.seed is not None),
        estimate_t(raw.of_runs),
        estimate_t(raw.of_tracks),
        estimate(statistics.interquartile_mean, test),
        train and estimate_t(train[0].of_runs),
        train and estimate(statistics.gap, train[1], test),
        {name: estimate_t([part[name] for part in parts]) for name in parts[0]},
        _returns(curves) if len(curves) == len(runs) else None,
        tuple(sorted({run.test.entry.plan.about.summary for run in runs})),
        fmean(steps) if len(steps) == len(runs) else None,
        fmean(curve.seconds[-1] for curve in curves) / _SECONDS_PER_HOUR if curves else None,
    )


def _train_tables(runs: Sequence[SuiteRun]) -> tuple[ScoreTable, ScoreTable] | None:
    """Returns the metric and the scores on the training tracks; ``None`` if a run has none."""
    if any(run.train is None for run in runs):
        return None
    return _table(runs, is_train=True, is_raw=True), _table(runs, is_train=True)


def _table(runs: Sequence[SuiteRun], *, is_train: bool = False, is_raw: bool = False) -> ScoreTable:
    """Returns the scores on a split's tracks: the metric itself, or on the task's scale."""
    evaluations = [run.train if is_train else run.test for run in runs]
    values = np.stack([evaluation.by_column() for evaluation in evaluations if evaluation])
    if not is_raw:
        values = _on_scale(runs[0], values)
    return ScoreTable(values, runs[0].name, is_train, len(DIRECTIONS))


def _on_scale(run: SuiteRun, values: FloatArray) -> FloatArray:
    zero, one = scale_ends(run.task.name, run.test.entry.plan.fresh)
    return (values - zero) / (one - zero)


def _power(groups: Iterable[Sequence[SuiteRun]]) -> document.PowerReport | None:
    """Returns how many runs a comparison of learned algorithms needs."""
    by_algorithm: dict[str, list[float]] = {}
    for runs in groups:  # other variants are of the same runs
        if runs[0].agent_class == LEARNED:
            by_algorithm.setdefault(runs[0].name[0], _table(runs, is_raw=True).of_runs)
    means = by_algorithm.values()
    freedom = sum(len(values) - 1 for values in means)
    if not freedom:
        return None
    squares = sum((value - fmean(values)) ** 2 for values in means for value in values)
    deviation = math.sqrt(squares / freedom)
    if not deviation:
        return None
    return document.PowerReport(
        deviation, freedom, {str(size): runs_needed(deviation, size) for size in _DIFFERENCES}
    )


def _returns(curves: Sequence[LearningCurve]) -> document.Band | None:
    """Returns the mean of the learning curves where all have values; ``None`` without any."""
    points = []
    for curve in curves:
        pairs = zip(curve.kart_steps, curve.returns, strict=True)
        known = [(steps, value) for steps, value in pairs if value is not None]
        if not known:
            return None
        points.append(np.array(known, float).T)
    start, end = max(steps[0] for steps, _ in points), min(steps[-1] for steps, _ in points)
    x = np.linspace(start, max(start, end), _NUM_POINTS)
    values = np.stack([np.interp(x, steps, returns) for steps, returns in points])
    columns = (x, values.mean(axis=0), values.min(axis=0), values.max(axis=0))
    shown, mean, low, high = (tuple(column.round(6).tolist()) for column in columns)
    ends = (low, high) if len(curves) > 1 else (None, None)
    return document.Band(shown, mean, *ends)


# ------------------------------------------------------------------ the files


def report_sections(report: document.SuiteReport, figures: Mapping[str, Path]) -> str:
    """Returns all tables and figures as Markdown, with headings of level 2.

    Args:
        report: the report.
        figures: file of each figure by name, relative to the page.
    """
    return render(
        Path(__file__).with_name("sections.md.jinja"),
        report=report,
        figures=figures,
        interval=_interval,
        normalized=document.NORMALIZED,
        time_ratio=TIME_RATIO,
    ).strip()


def _interval(estimate: Estimate) -> str:
    """Returns the interval of an estimate as text, or ``-`` without one."""
    _, _, ends = str(estimate).partition(" ")
    return ends.strip("()") or "-"


def marl_eval_json(runs: Sequence[SuiteRun]) -> str:
    """Returns runs as JSON text for MARL-eval: environment, task, algorithm, run, step, metrics.

    MARL-eval (Gorsane et al., 2022, https://github.com/instadeepai/marl-eval) requires the same
    metrics in all steps and in the absolute metrics of an environment. Training and evaluation
    measure different things, so they are two environments:

    - ``stkzoo-suite-1`` has one step, the end of the training, with the score of each race on the
      test tracks, on the scale of the task;
    - ``stkzoo-suite-1-training`` has the learning curve, at equal distances. Runs without a log are
      left out.

    It also requires the same algorithms and seeds in all tasks.

    Args:
        runs: the runs.
    """
    environments: dict[str, Any] = {SUITE: {}, f"{SUITE}-training": {}}
    for run in runs:
        score = {"score": _on_scale(run, np.array(run.test.values())).tolist()}
        curve = _curve_steps(run.curve) if run.curve else []
        ends = [{"step_count": run.kart_steps or 0, **score}]
        algorithm = ", ".join(filter(None, run.name))
        for tasks, steps in zip(environments.values(), (ends, curve), strict=True):
            if steps:
                absolute = {
                    name: value for name, value in steps[-1].items() if name != "step_count"
                }
                numbered = {f"step_{number}": step for number, step in enumerate(steps)}
                seeds = tasks.setdefault(run.task.name, {}).setdefault(algorithm, {})
                seeds[f"seed_{run.seed or 0}"] = {**numbered, "absolute_metrics": absolute}
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
) -> document.SuiteReport:
    """Writes the report of training runs: numbers, tables and figures.

    The same entries make the same files.

    Args:
        paths: folders of entries, and folders that contain them.
        output: folder for ``report.json``, ``report.md``, ``marl_eval.json`` and the figures. It is
            created if needed.

    Returns:
        The report.

    Raises:
        ConfigError: see :func:`~stkzoo.suite.report.runs.load_runs`; or a library is missing, or a
            file cannot be written.
        EntryRefused: an entry is incomplete, or a replay or a number is not that of the entry.
    """
    folder = Path(output)
    require_matplotlib()
    require_jinja2()
    runs = load_runs(paths)
    report = make_report(runs)
    make_folder(folder, "report")
    figures = draw_figures(report, folder)
    versions = ", ".join(f"{name} {' and '.join(of)}" for name, of in report.versions.items())
    head = f"# Report on {report.suite}\n\nVersions: {versions}."
    write_text(folder / "report.json", report.to_json() + "\n")
    write_text(folder / "marl_eval.json", marl_eval_json(runs))
    write_text(folder / "report.md", f"{head}\n\n{report_sections(report, figures)}\n")
    return report
