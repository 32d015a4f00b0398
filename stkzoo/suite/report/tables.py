"""Tables of a report, in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from stkzoo.suite.report.document import (
    NORMALIZED,
    AlgorithmReport,
    RunKey,
    SuiteReport,
    TaskReport,
)
from stkzoo.suite.tasks import TIME_RATIO

#: Captions of the figures, by name.
CAPTIONS = {
    "learning_curves": "Mean return of the training races. Bands contain all runs.",
    "scores": "Interquartile mean on the test tracks, with 95% intervals.",
    "profiles": "Share of runs, tracks and directions with a score above each value, with 95% "
    "bands.",
    "improvement": "Probability that a run of the first algorithm is better than one of the "
    "second on a track and direction, with 95% intervals.",
    "gap": "Mean score on the training tracks minus that on the test tracks, with 95% intervals.",
}
_HOURS = "{:.2f}"


def report_page(report: SuiteReport, figures: Mapping[str, Path]) -> str:
    """Returns the page ``report.md``.

    Args:
        report: the report.
        figures: file of each figure by name, relative to the page.
    """
    versions = ", ".join(
        f"{name} {' and '.join(of_name)}" for name, of_name in report.versions.items()
    )
    head = f"# Report on {report.suite}\n\nVersions: {versions}."
    return f"{head}\n\n{report_sections(report, figures)}\n"


def report_sections(report: SuiteReport, figures: Mapping[str, Path]) -> str:
    """Returns all tables and figures as Markdown, with headings of level 2.

    Args:
        report: the report.
        figures: file of each figure by name, relative to the page.
    """
    sections = {
        "Scores": (_score_table(report.tasks), _overall_table(report)),
        "Comparison of algorithms": (_improvement_table(report),),
        "Compute": (_compute_table(report.tasks),),
        "Missing runs": (missing_runs(report.missing),),
    }
    places = {
        "Scores": ("scores", "profiles", "learning_curves", "gap"),
        "Comparison of algorithms": ("improvement",),
    }
    parts = []
    for title, texts in sections.items():
        pictures = [
            f"![{CAPTIONS[name]}]({figures[name].as_posix()})\n\n{CAPTIONS[name]}"
            for name in places.get(title, ())
            if name in figures
        ]
        if shown := [*filter(None, texts), *pictures]:
            parts.append("\n\n".join([f"## {title}", *shown]))
    return "\n\n".join(parts)


def _score_table(tasks: Sequence[TaskReport]) -> str:
    rows = [
        (
            task.task,
            result.algorithm,
            task.metric.replace("_", " "),
            str(len(result.seeds)),
            str(result.score),
            str(result.train_score),
            str(result.iqm),
            str(result.gap),
        )
        for task, result in _each(tasks)
    ]
    columns = ("task", "algorithm", "metric", "runs", "test", "training", "IQM", "gap")
    note = (
        "*Test* and *training* are means of the metric on these tracks. *IQM* is the interquartile "
        "mean on the test tracks, and *gap* the mean on the training tracks minus that on the test "
        "tracks. Both are on the scale of normalized scores, where higher is better."
    )
    raw = [task for task in tasks if task.scale != NORMALIZED]
    if raw:
        names = ", ".join(f"`{task.task}`" for task in raw)
        note += f" {names}: the baselines have not been measured, so the scale is the metric"
        sign = ", and a time ratio has a minus sign." if _has_time_ratio(raw) else "."
        note += sign
    return f"{_table(columns, rows, 3)}\n\n{note}"


def _has_time_ratio(tasks: Sequence[TaskReport]) -> bool:
    return any(task.metric == TIME_RATIO for task in tasks)


def _overall_table(report: SuiteReport) -> str:
    if report.overall is None:
        return ""
    rows = [
        (result.algorithm, str(len(result.seeds)), str(result.iqm))
        for result in report.overall.algorithms
    ]
    names = ", ".join(f"`{name}`" for name in report.overall.tasks)
    table = _table(("algorithm", "runs per task", "IQM"), rows, 1)
    return f"From the scores of runs in {len(report.overall.tasks)} tasks ({names}):\n\n{table}"


def _improvement_table(report: SuiteReport) -> str:
    rows = [
        (task.task, result.first, result.second, str(result.probability))
        for task in report.tasks
        for result in task.improvements
    ]
    if report.overall is not None:
        rows += [
            ("all of these", pair.first, pair.second, str(pair.probability))
            for pair in report.overall.improvements
        ]
    return _table(("task", "first", "second", "first is better"), rows, 3) if rows else ""


def _compute_table(tasks: Sequence[TaskReport]) -> str:
    rows = [
        (
            task.task,
            result.algorithm,
            " ".join(map(str, result.seeds)),
            f"{result.kart_steps:,.0f}",
            _HOURS.format(result.training_hours),
            _HOURS.format(result.evaluation_hours),
            " or ".join(map(str, result.cores)),
        )
        for task, result in _each(tasks)
    ]
    columns = ("task", "algorithm", "seeds", "kart-steps", "train [h]", "evaluate [h]", "cores")
    return f"{_table(columns, rows, 2)}\n\nKart-steps and hours are means per run." if rows else ""


def missing_runs(missing: Sequence[RunKey]) -> str:
    """Returns a list of missing runs; empty without any.

    Args:
        missing: task, algorithm and seed of each run.
    """
    seeds: dict[tuple[str, str], list[str]] = {}
    for task, algorithm, seed in missing:
        seeds.setdefault((task, algorithm), []).append(str(seed))
    lines = (
        f"- {task}, {name}: seed {', '.join(numbers)}" for (task, name), numbers in seeds.items()
    )
    return "\n".join(lines)


def _each(tasks: Iterable[TaskReport]) -> Iterable[tuple[TaskReport, AlgorithmReport]]:
    return ((task, result) for task in tasks for result in task.algorithms)


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]], num_left: int) -> str:
    """Returns a table whose first columns are left-aligned."""
    rule = ["---" if number < num_left else "---:" for number in range(len(columns))]
    return "\n".join(f"| {' | '.join(row)} |" for row in (columns, rule, *rows))
