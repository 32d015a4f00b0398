"""Draws the curves of runs of ``ppo_selfplay``.

python -m stkzoo.agents.training.plot runs/first runs/second --output curves.png
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo.errors import ConfigError
from stkzoo.evaluation.plotting import new_figure, save_figure

from .common.training_log import log_of_run

__all__ = ["main", "plot_runs"]

#: What is drawn: title, and the log's entries with their labels.
_PANELS: tuple[tuple[str, dict[str, str]], ...] = (
    (
        "time over the AI's median time",
        {
            "alone_finished_ratio": "alone",
            "selfplay_finished_ratio": "among themselves",
            "rivals_finished_ratio": "against the AI",
        },
    ),
    (
        "share of karts",
        {
            "selfplay_unfinished": "cut short, among themselves",
            "rivals_unfinished": "cut short, against the AI",
            "rivals_first": "first, against the AI",
        },
    ),
    ("metres a step / 20", {"reward": "reward"}),
    ("value explained", {"explained": "share of variance"}),
)


def plot_runs(folders: Sequence[str | Path], output: str | Path) -> None:
    """Draws the curves of runs into a picture.

    Args:
        folders: of the runs.
        output: the picture's file.

    Raises:
        ConfigError: a run has no log, or matplotlib is missing.
    """
    figure = new_figure(10, 6)
    axes = figure.subplots(2, 2)
    for folder in folders:
        lines = log_of_run(folder)
        for axis, (title, entries) in zip(axes.flat, _PANELS, strict=True):
            axis.set_title(title, fontsize=10)
            for entry, label in entries.items():
                found = [(line["kart_steps"], line[entry]) for line in lines if entry in line]
                if not found:
                    continue
                steps, values = np.array(found, float).T
                whose = f"{label} ({Path(folder).name})" if len(folders) > 1 else label
                axis.plot(steps / 1e6, _smooth(values), label=whose)
            axis.set_xlabel("million kart-steps", fontsize=8)
            axis.grid(alpha=0.3)
            if axis.lines:
                axis.legend(fontsize=7)
    save_figure(figure, output)


def _smooth(values: np.ndarray[Any, np.dtype[np.float64]], width: int = 9) -> Any:
    """A running mean; the ends have shorter ones."""
    window = np.ones(min(width, len(values)))
    sums = np.convolve(values, window, mode="same")
    return sums / np.convolve(np.ones_like(values), window, mode="same")


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m stkzoo.agents.training.plot",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("runs", nargs="+", help="folders of runs")
    parser.add_argument("--output", default="curves.png", help="(default: curves.png)")
    options = parser.parse_args(words)
    try:
        plot_runs(options.runs, options.output)
    except ConfigError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
