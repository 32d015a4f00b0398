"""Plots the training curves of runs of any script, or the evaluations of their policies.

    python -m stkzoo.agents.training.plot runs/first runs/second --output curves.png

The plot has one panel per group of figures in the logs: time ratios, places, rewards and
wins. Each run has a color.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._arguments import option, positional
from stkzoo._reading import Unreadable, reading
from stkzoo.errors import ConfigError
from stkzoo.evaluation import GRAY, INK, new_figure, save_figure, style_axes

from .common.command import run_command
from .common.run_folder import LOG, read_log

#: A rating and both ends of its interval.
Interval = Sequence[float]


#: Panels: title, and names of the figures in the log.
_PANELS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (
        "Time over the AI's median time",
        ("alone_finished_ratio", "selfplay_finished_ratio", "rivals_finished_ratio"),
    ),
    ("Share of karts", ("selfplay_unfinished", "rivals_unfinished", "rivals_first")),
    ("Reward per step", ("reward",)),
    ("Explained variance of the value", ("explained",)),
    ("Pace over the AI's, and share of karts that finished", ("pace", "finished")),
    ("Share of opponents beaten", ("beaten", "won")),
    ("Return of a race", ("return",)),
    ("Time over the AI's median time", ("time_ratio",)),
    ("Loss [nats]", ("loss",)),
)
#: Styles of the figures of a panel, if colors mean runs.
_STYLES = ("-", "--", ":", "-.")


def plot_runs(folders: Sequence[str | Path], output: str | Path) -> None:
    """Plots the curves of runs.

    Args:
        folders: folders of the runs.
        output: file of the plot.

    Raises:
        ConfigError: a run has no log, or matplotlib is missing.
    """
    logs = {Path(folder).name: read_figures(folder) for folder in folders}
    names = {name for log in logs.values() for line in log for name in line}
    panels = [panel for panel in _PANELS if names & set(panel[1])]
    rows = max(-(-len(panels) // 2), 1)
    columns = 2 if len(panels) > 1 else 1
    figure = new_figure(10, 2.8 * rows)
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axis, (title, entries) in zip(axes, panels, strict=False):
        style_axes(axis, title)
        entries = tuple(entry for entry in entries if entry in names)
        for number, log in enumerate(logs.values()):
            for color, (entry, style) in enumerate(zip(entries, _STYLES, strict=False)):
                look = {"color": f"C{color}"}
                if len(logs) > 1:
                    look = {"color": f"C{number}", "linestyle": style}
                _draw_curve(axis, log, entry, **look)
        unit = "million kart-steps" if "kart_steps" in names else "round"
        axis.set_xlabel(unit, fontsize=8, color=INK)
        axis.grid(alpha=0.3)
        curves = dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
        if curves:
            axis.legend(curves.values(), curves, fontsize=7)
    for axis in axes[len(panels) :]:
        axis.remove()
    if len(logs) > 1:
        lines = [axes[0].plot([], [], color=f"C{number}")[0] for number in range(len(logs))]
        figure.legend(lines, logs, loc="outside upper center", ncols=min(len(logs), 6), fontsize=8)
    save_figure(figure, output)


def _draw_curve(axis: Any, log: Sequence[Mapping[str, Any]], entry: str, **look: str) -> None:
    """Draws a figure of a log, if it has been measured."""
    measured = [line for line in log if line.get(entry) is not None]
    if not measured:
        return
    steps = [_x(line) for line in measured]
    values = _smooth(np.array([line[entry] for line in measured], float))
    (curve,) = axis.plot(steps, values, label=entry, **look)
    if entry == "time_ratio" and "error" in measured[0]:
        error = 1.96 * np.array([line["error"] for line in measured])
        _draw_band(axis, curve, steps, values - error, values + error)


def _x(line: Mapping[str, Any]) -> float:
    """Returns the x coordinate of a log line."""
    return float(line["kart_steps"] / 1e6 if "kart_steps" in line else line["round"])


def read_figures(folder: str | Path) -> list[dict[str, Any]]:
    """Returns the lines of a run's log, and checks that their figures can be drawn.

    Raises:
        ConfigError: the folder has no log, or the log is damaged.
    """
    file = Path(folder) / LOG
    if not file.is_file():
        raise ConfigError(f"{str(folder)!r} is not the folder of a run: it has no {LOG}")
    log = read_log(Path(folder))
    with reading(f"{str(file)!r} cannot be drawn", "the log of a run"):
        for number, line in enumerate(log, 1):
            if "kart_steps" not in line and "round" not in line:
                raise Unreadable(f"line {number} has neither kart_steps nor round")
    return log


def _smooth(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns a running mean over up to nine values, with shorter windows at the ends."""
    window = np.ones(min(1 + len(values) // 10, 9))
    sums = np.convolve(values, window, mode="same")
    return sums / np.convolve(np.ones_like(values), window, mode="same")


def _draw_band(axis: Any, curve: Any, steps: Any, lows: Any, highs: Any) -> None:
    axis.fill_between(steps, lows, highs, color=curve.get_color(), alpha=0.15, linewidth=0)


def rating_figure(
    curves: Mapping[str, Sequence[tuple[float, Interval]]],
    levels: Mapping[str, float],
) -> Any:
    """Returns a figure of ratings over kart-steps.

    Args:
        curves: kart-steps [millions] and rating of each policy, by name of the curve.
        levels: ratings of fixed drivers, by name.
    """
    figure = new_figure(8, 4.5)
    axis = figure.subplots()
    style_axes(axis)
    for name, points in curves.items():
        steps = [at for at, _ in points]
        values, lows, highs = np.array([rating for _, rating in points], float).reshape(-1, 3).T
        marks = {"marker": "o", "markersize": 3, "gid": f"curve {name}"}
        (curve,) = axis.plot(steps, values, label=name, **marks)
        _draw_band(axis, curve, steps, lows, highs)
    for name, style in zip(levels, ("--", ":"), strict=False):
        axis.axhline(levels[name], color=GRAY, linewidth=0.8, linestyle=style, label=name)
    axis.set_xlabel("million kart-steps", color=INK)
    axis.set_ylabel("rating (Plackett-Luce; bands: 95%)", color=INK)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, framealpha=0.0, labelcolor=INK)
    return figure


@dataclass(frozen=True, slots=True)
class PlotOptions:
    """Options of the command.

    Attributes:
        runs: folders of runs.
        output: file of the plot.
    """

    runs: tuple[Path, ...] = positional()
    output: Path = option(Path("curves.png"), metavar="FILE")


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""

    def plot(options: PlotOptions) -> None:
        plot_runs(options.runs, options.output)

    return run_command("plot", __doc__, plot, (PlotOptions,), words)


if __name__ == "__main__":
    sys.exit(main())
