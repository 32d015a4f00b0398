"""Figures of a report: learning curves, scores and comparisons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stkzoo.evaluation import plotting
from stkzoo.evaluation.statistics import Estimate
from stkzoo.suite.report.document import Band, SuiteReport

#: Colors that people with any kind of color blindness can tell apart (Okabe and Ito, 2008).
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_LINES = ("-", "--", "-.", ":")
_PANEL = (5.0, 2.9)
_ROW = 0.3
#: A row of a figure with intervals: its label, its algorithm for the color, and its estimate.
_Row = tuple[str, str, Estimate]


def draw_figures(report: SuiteReport, folder: Path) -> dict[str, Path]:
    """Draws the figures of a report as SVG files.

    Args:
        report: the report.
        folder: folder for the files.

    Returns:
        File of each figure by name, relative to the folder.

    Raises:
        ConfigError: matplotlib is not installed, or a file cannot be written.
    """
    files = {}
    for name, draw in FIGURES.items():
        if (figure := draw(report)) is not None:
            files[name] = Path(f"{name}.svg")
            plotting.save_figure(figure, folder / files[name])
    return files


def learning_curves(report: SuiteReport) -> Any:
    """Returns the figure of returns during the trainings; ``None`` if there are none."""
    panels = {
        task.task: {result.name: result.returns for result in task.algorithms if result.returns}
        for task in report.tasks
    }
    panels = {title: curves for title, curves in panels.items() if curves}
    if not panels:
        return None
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    figure = plotting.new_figure(_PANEL[0] * columns, _PANEL[1] * rows + 0.4)
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    styles = _styles(report)
    handles: dict[str, Any] = {}
    for axis, (title, curves) in zip(axes, panels.items(), strict=False):
        plotting.style_axes(axis, title)
        handles |= {name: _draw_band(axis, band, *styles[name]) for name, band in curves.items()}
        axis.set_xlabel("million kart-steps", fontsize=9, color=plotting.INK)
        axis.set_ylabel("return of a race", fontsize=9, color=plotting.INK)
        axis.grid(color=plotting.GRAY, alpha=0.25)
    for axis in axes[len(panels) :]:
        axis.remove()
    looks = {"ncols": 6, "frameon": False, "fontsize": 9, "handlelength": 3}
    figure.legend(handles.values(), handles, loc="outside lower center", **looks)
    return figure


def _draw_band(axis: Any, band: Band, color: str, line: str) -> Any:
    """Draws a curve over kart-steps with its band; returns the curve for the legend."""
    x = [kart_steps / 1e6 for kart_steps in band.x]
    (curve,) = axis.plot(x, band.values, line, color=color, linewidth=1.8)
    if band.low is not None and band.high is not None:
        axis.fill_between(x, band.low, band.high, color=color, alpha=0.18, linewidth=0)
    return curve


def scores(report: SuiteReport) -> Any:
    """Returns the figure of interquartile means."""
    panels: dict[str, list[_Row]] = {}
    for task in report.tasks:
        title = f"IQM, {task.scale.replace('_', ' ')}; more is better"
        panels.setdefault(title, []).extend(
            (f"{task.task}, {result.name}", result.name, result.iqm) for result in task.algorithms
        )
    return _intervals(panels, _styles(report))


def improvement(report: SuiteReport) -> Any:
    """Returns the figure of comparisons; ``None`` with a single algorithm."""
    rows = [
        (f"{task.task}, {pair.first} over {pair.second}", pair.first, pair.probability)
        for task in report.tasks
        for pair in task.improvements
    ]
    title = "Probability of improvement; 0.5 is chance"
    panels = {title: rows} if rows else {}
    return _intervals(panels, _styles(report), is_probability=True)


#: The functions that draw the figures, by name of the figure.
FIGURES = {draw.__name__: draw for draw in (learning_curves, scores, improvement)}


def _styles(report: SuiteReport) -> dict[str, tuple[str, str]]:
    """Returns the color and the line of each algorithm."""
    names = sorted({result.name for task in report.tasks for result in task.algorithms})
    return {
        name: (_COLORS[number % len(_COLORS)], _LINES[number % len(_LINES)])
        for number, name in enumerate(names)
    }


def _intervals(
    panels: Mapping[str, Sequence[_Row]],
    styles: Mapping[str, tuple[str, str]],
    *,
    is_probability: bool = False,
) -> Any:
    """Returns a figure with a panel of intervals for each title; ``None`` without panels."""
    if not panels:
        return None
    counts = [len(rows) for rows in panels.values()]
    figure = plotting.new_figure(7.5, sum(0.8 + _ROW * count for count in counts))
    axes = figure.subplots(len(panels), 1, squeeze=False, height_ratios=counts)[:, 0]
    for axis, (title, rows) in zip(axes, panels.items(), strict=True):
        for place, (_, algorithm, estimate) in enumerate(rows):
            plotting.draw_intervals(axis, {place: estimate}, color=styles[algorithm][0])
        start = 0.5 if is_probability else 0.0
        axis.axvline(start, color=plotting.GRAY, linewidth=1.2, linestyle="--", zorder=0)
        if is_probability:
            axis.set_xlim(-0.03, 1.03)
        axis.set_yticks(range(len(rows)), [label for label, _, _ in rows])
        axis.set_ylim(len(rows) - 0.4, -0.6)
        plotting.style_axes(axis, title)
    return figure
