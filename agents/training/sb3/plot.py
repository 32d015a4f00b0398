"""Draws the curves of a run of ``sb3_selfplay``.

python -m stkzoo.agents.training.sb3.plot runs/first --output curves.png
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo.errors import ConfigError
from stkzoo.evaluation.plotting import BLUE, GREY, INK, new_figure, save_figure, style_axes

from ..common.training_log import log_of_run

__all__ = ["main", "plot_run"]

_DRIVING = {"pace": "pace, of the AI's", "finished": "finished"}
_DUELS = {"beats_past": "past selves", "beats_bots": "the game's bots"}


def plot_run(run: str | Path, output: str | Path) -> None:
    """Draws a run's curves into a picture.

    Args:
        run: its folder.
        output: the picture's file.

    Raises:
        ConfigError: there is no such run, or matplotlib is missing.
    """
    folder = Path(run)
    lines = log_of_run(folder)
    ratings: dict[str, Any] = {"policies": [], "others": {}}
    if (folder / "ratings.json").exists():
        ratings = json.loads((folder / "ratings.json").read_text())
    figure = new_figure(9, 5.6)
    axes = figure.subplots(2, 2)
    _draw_ratings(axes[0, 0], ratings)
    _draw_time_ratios(axes[0, 1], ratings["policies"])
    _draw_log(axes[1, 0], lines, _DRIVING, "Driving, last 100 karts of training")
    _draw_log(axes[1, 1], lines, _DUELS, "Share of rivals beaten in training")
    for axis in axes.flat:
        axis.set_xlabel("kart-steps [thousand]", fontsize=8, color=INK)
        axis.grid(alpha=0.3)
        style_axes(axis)
    save_figure(figure, output)


def _draw_ratings(axis: Any, ratings: dict[str, Any]) -> None:
    axis.set_title("Rating, with 95 % interval", fontsize=10, color=INK)
    policies = ratings["policies"]
    steps = [policy["kart_steps"] / 1000 for policy in policies]
    if policies:
        values, lows, highs = (
            [policy[name] for policy in policies]
            for name in ("rating", "rating_low", "rating_high")
        )
        axis.fill_between(steps, lows, highs, color=BLUE, alpha=0.15, linewidth=0)
        axis.plot(steps, values, color=BLUE, marker="o", markersize=3)
    others = {n: r["value"] for n, r in ratings["others"].items() if not n.startswith("policy-")}
    for names, value in _near_each_other(others):
        axis.axhline(value, color=GREY, linewidth=0.8, linestyle=":")
        across = axis.get_yaxis_transform()
        axis.annotate(names, (1.0, value), xycoords=across, fontsize=7, color=INK, va="center")


def _near_each_other(values: dict[str, float]) -> list[tuple[str, float]]:
    """Names that stand at nearly one height as one, and that height."""
    room = 0.06 * (max(values.values()) - min(values.values())) if values else 0.0
    groups: list[list[str]] = []
    for name in sorted(values, key=lambda name: (values[name], name)):
        if groups and values[name] - values[groups[-1][0]] < room:
            groups[-1].append(name)
        else:
            groups.append([name])
    return [(", ".join(sorted(g)), float(np.mean([values[n] for n in g]))) for g in groups]


def _draw_time_ratios(axis: Any, policies: list[dict[str, Any]]) -> None:
    axis.set_title("Time over that of the game's AI, by likeliest choices", fontsize=10, color=INK)
    steps = [policy["kart_steps"] / 1000 for policy in policies]
    ratios = [policy["time_ratio"] for policy in policies]
    axis.plot(steps, ratios, color=BLUE, marker="o", markersize=3)
    axis.set_yscale("log")
    ticks = [0.8, 1, 1.5, 2, 3, 5, 10]
    axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.minorticks_off()
    axis.set_ylim(0.75, 11)
    axis.axhline(1.0, color=GREY, linewidth=0.8, linestyle=":")


def _draw_log(axis: Any, lines: list[dict[str, float]], names: dict[str, str], title: str) -> None:
    axis.set_title(title, fontsize=10, color=INK)
    for name, label in names.items():
        found = [(line["kart_steps"] / 1000, line[name]) for line in lines if name in line]
        if found:
            steps, values = np.array(found).T
            axis.plot(steps, values, label=label)
    if axis.lines:
        axis.legend(fontsize=7)


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m stkzoo.agents.training.sb3.plot", description=__doc__
    )
    parser.add_argument("run", help="the run's folder")
    parser.add_argument("--output", default="curves.png", help="(default: curves.png)")
    options = parser.parse_args(words)
    try:
        plot_run(options.run, options.output)
    except ConfigError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
