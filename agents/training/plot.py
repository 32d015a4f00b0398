"""Plots the training curves of runs of any script.

    python -m stkzoo.agents.training.plot runs/first runs/second --output curves.png

There is one panel per group of figures that the runs have: time ratios, places, rewards, wins, and
the ratings of evaluations beside the training. A run of ``imitation`` has its own plot.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo.evaluation import BLUE, GREY, INK, Rating, new_figure, save_figure, style_axes

from .common.command import command_parser, run_command
from .common.training_log import require_log

#: Panels: title, and the log's figures with their labels.
_PANELS: tuple[tuple[str, dict[str, str]], ...] = (
    (
        "Time over the AI's median time",
        {
            "alone_finished_ratio": "alone",
            "selfplay_finished_ratio": "among themselves",
            "rivals_finished_ratio": "against the AI",
        },
    ),
    (
        "Share of karts",
        {
            "selfplay_unfinished": "cut short, among themselves",
            "rivals_unfinished": "cut short, against the AI",
            "rivals_first": "first, against the AI",
        },
    ),
    ("Reward per step", {"reward": "reward"}),
    ("Explained variance of the value", {"explained": "explained"}),
    ("Driving, last 100 karts", {"pace": "pace, of the AI's", "finished": "finished"}),
    (
        "Share of opponents beaten",
        {"beats_past": "past selves", "beats_bots": "the game's bots", "win_share": "past selves"},
    ),
    ("Return of a race", {"return": "return"}),
    (
        "Time over the AI's median time",
        {"time_ratio_alone": "the network alone", "driver_time_ratio": "the driver"},
    ),
    ("Loss [nats]", {"loss": "loss"}),
)


def plot_runs(folders: Sequence[str | Path], output: str | Path) -> None:
    """Plots the curves of runs.

    Args:
        folders: of the runs.
        output: the plot's file.

    Raises:
        ConfigError: a run has no log, or matplotlib is missing.
    """
    logs = [(Path(folder).name, require_log(folder)) for folder in folders]
    if any("time_ratio" in line for _, log in logs for line in log):
        plot_imitation(logs[0][1], output)
        return
    names = {name for _, log in logs for line in log for name in line}
    panels = [panel for panel in _PANELS if names & set(panel[1])]
    ratings = [(Path(folder).name, _read_ratings(Path(folder))) for folder in folders]
    ratings = [(run, found) for run, found in ratings if found]
    count = len(panels) + 2 * bool(ratings)
    rows = max(-(-count // 2), 1)
    figure = new_figure(10, 2.8 * rows)
    axes = list(figure.subplots(rows, 2, squeeze=False).flat)
    for axis, (title, entries) in zip(axes, panels, strict=False):
        style_axes(axis, title)
        for run, log in logs:
            for entry, label in entries.items():
                found = [(_x(line), line[entry]) for line in log if line.get(entry) is not None]
                if found:
                    whose = f"{label} ({run})" if len(logs) > 1 else label
                    steps, values = np.array(found, float).T
                    axis.plot(steps, _smooth(values), label=whose)
    for run, policies in ratings:
        _draw_evaluations(axes[count - 2], axes[count - 1], run, policies)
    for axis in axes[:count]:
        label = "million kart-steps" if "kart_steps" in names else "round"
        axis.set_xlabel(label, fontsize=8, color=INK)
        axis.grid(alpha=0.3)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7)
    for axis in axes[count:]:
        axis.remove()
    save_figure(figure, output)


def _x(line: Mapping[str, Any]) -> float:
    """Where a line of a log is drawn."""
    return float(line["kart_steps"] / 1e6 if "kart_steps" in line else line["round"])


def _read_ratings(folder: Path) -> dict[str, Any]:
    file = folder / "ratings.json"
    return json.loads(file.read_text()) if file.exists() else {}


def _smooth(values: np.ndarray[Any, np.dtype[np.float64]], width: int = 9) -> Any:
    """A running mean; shorter at the ends."""
    window = np.ones(min(width, len(values)))
    sums = np.convolve(values, window, mode="same")
    return sums / np.convolve(np.ones_like(values), window, mode="same")


def _draw_evaluations(rating_axis: Any, time_axis: Any, run: str, ratings: dict[str, Any]) -> None:
    """Ratings and time ratios of a run's kept policies."""
    policies = ratings["policies"]
    steps = [policy["kart_steps"] / 1e6 for policy in policies]
    values, lows, highs, ratios = (
        [policy[name] for policy in policies]
        for name in ("rating", "rating_low", "rating_high", "time_ratio")
    )
    style_axes(rating_axis, "Rating, with 95 % interval")
    (line,) = rating_axis.plot(steps, values, marker="o", markersize=3, label=run)
    rating_axis.fill_between(steps, lows, highs, color=line.get_color(), alpha=0.15, linewidth=0)
    others = {n: r["value"] for n, r in ratings["others"].items() if not n.startswith("policy-")}
    across = rating_axis.get_yaxis_transform()
    for names, value in _near_each_other(others):
        rating_axis.axhline(value, color=GREY, linewidth=0.8, linestyle=":")
        rating_axis.annotate(
            names, (1.0, value), xycoords=across, fontsize=7, color=INK, va="center"
        )
    style_axes(time_axis, "Time over that of the game's AI, evaluated")
    time_axis.plot(steps, ratios, marker="o", markersize=3, label=run)
    time_axis.set_yscale("log")
    ticks = [0.8, 1, 1.5, 2, 3, 5, 10]
    time_axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    time_axis.minorticks_off()
    time_axis.set_ylim(0.75, 11)
    time_axis.axhline(1.0, color=GREY, linewidth=0.8, linestyle=":")


def _near_each_other(values: dict[str, float]) -> list[tuple[str, float]]:
    """Joins names at nearly the same height; with that height."""
    room = 0.06 * (max(values.values()) - min(values.values())) if values else 0.0
    groups: list[list[str]] = []
    for name in sorted(values, key=lambda name: (values[name], name)):
        if groups and values[name] - values[groups[-1][0]] < room:
            groups[-1].append(name)
        else:
            groups.append([name])
    return [(", ".join(sorted(g)), float(np.mean([values[n] for n in g]))) for g in groups]


def draw_ratings(
    curves: Mapping[str, Sequence[tuple[float, Rating]]],
    ai: Rating | None,
    count: int,
    output: str | Path,
) -> None:
    """Plots the ratings of kept policies over kart-steps.

    Args:
        curves: by run: millions of kart-steps and rating of each policy.
        ai: the rating of the game's AI.
        count: how many races they come from.
        output: the plot's file.
    """
    figure = new_figure(8, 4.5)
    axis = figure.subplots()
    for run, points in sorted(curves.items()):
        steps = [at for at, _ in points]
        (line,) = axis.plot(steps, [r.value for _, r in points], marker="o", ms=3, label=run)
        lows, highs = [r.low for _, r in points], [r.high for _, r in points]
        axis.fill_between(steps, lows, highs, alpha=0.15, color=line.get_color(), lw=0)
    if ai:
        axis.axhline(ai.value, color="0.4", ls="--", label="the game's AI at its hardest")
        axis.axhspan(ai.low, ai.high, color="0.4", alpha=0.1, lw=0)
    axis.set_xlabel("million kart-steps")
    axis.set_ylabel("rating (Plackett-Luce; bands: 95 %)")
    axis.set_title(f"Kept policies in {count} races against one another", fontsize=10)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    save_figure(figure, output)


def plot_imitation(log: Sequence[Mapping[str, Any]], output: str | Path) -> None:
    """Plots a run of imitation: time ratio and share of finishers, round by round.

    Args:
        log: the run's.
        output: the plot's file.

    Raises:
        ConfigError: matplotlib is missing.
    """
    figure = new_figure(8, 3.6)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    teacher, *rounds = log
    places = list(range(len(rounds)))
    names = ["cloning", *(f"DAgger {n}" for n in places[1:])]
    left.errorbar(
        places,
        [line["time_ratio"] for line in rounds],
        yerr=[1.96 * line["error"] for line in rounds],
        color=BLUE,
        marker="o",
        capsize=3,
    )
    left.axhline(teacher["time_ratio"], color=GREY, linestyle="--", linewidth=1)
    left.text(
        places[-1], teacher["time_ratio"], teacher["driver"], color=GREY, ha="right", va="bottom"
    )
    right.bar(places, [100 * line["finished"] for line in rounds], color=BLUE, width=0.6)
    right.set_ylim(0, 100)
    titles = ("Time over the AI's median time", "Karts that finished [%]")
    for axis, title in zip((left, right), titles, strict=True):
        axis.set_xticks(places, names, rotation=30, ha="right")
        style_axes(axis, title)
        axis.grid(axis="y", color=GREY, alpha=0.25, linewidth=0.6)
        axis.set_axisbelow(True)
    save_figure(figure, output)


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    parser = command_parser("plot", __doc__)
    parser.add_argument("runs", nargs="+", help="folders of runs")
    parser.add_argument("--output", default="curves.png", help="the plot's file (curves.png)")
    options = parser.parse_args(words)
    return run_command(lambda: plot_runs(options.runs, options.output))


if __name__ == "__main__":
    sys.exit(main())
