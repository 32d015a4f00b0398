"""Tables of a report, in Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from stkzoo.evaluation.templates import render
from stkzoo.suite.report.document import NORMALIZED, SuiteReport
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
    comparisons = [(task.task, pair) for task in report.tasks for pair in task.improvements]
    if report.overall is not None:
        comparisons += [("all of these", pair) for pair in report.overall.improvements]
    return render(
        Path(__file__).with_name("sections.md.jinja"),
        report=report,
        figures=figures,
        captions=CAPTIONS,
        comparisons=comparisons,
        normalized=NORMALIZED,
        time_ratio=TIME_RATIO,
    ).strip()
