"""A tournament as a picture: ratings with intervals, and who beats whom."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from stkzoo.evaluation.batch.figure import (
    BLUE,
    INK,
    plot_library,
    save_figure,
    short,
    without_frame,
)
from stkzoo.evaluation.tournament.result import TournamentResult

__all__ = ["check_plot_library", "save_plot"]

_EXTRA = "tournament"


def check_plot_library() -> None:
    """Checks that the library which draws is there.

    Raises:
        ConfigError: it is not installed.
    """
    plot_library(_EXTRA)


def save_plot(result: TournamentResult, path: str | os.PathLike[str]) -> None:
    """Draws a tournament into a file, whole or not at all.

    Args:
        result: the tournament.
        path: the file; its ending says the format, such as ``.png`` or ``.svg``.

    Raises:
        ConfigError: the library is not installed, or the file cannot be written.
    """
    count = len(result.standings)
    height = 2.2 + 0.42 * count
    figure = plot_library(_EXTRA).Figure(
        figsize=(5.6 + 0.55 * count + 3, height), layout="constrained"
    )
    ratings, matrix = figure.subplots(1, 2, width_ratios=(5.2, 2.4 + 0.62 * count))
    _draw_ratings(ratings, result)
    _draw_matrix(matrix, result)
    num_races = len(result.races)
    figure.suptitle(
        f"{count} agents, {num_races} races of {result.plan.per_race} on "
        f"{_listed(result.plan.tracks)}",
        color=INK,
        fontsize=11,
    )
    save_figure(figure, path)


def _draw_ratings(axes: Any, result: TournamentResult) -> None:
    rows = range(len(result.standings))
    ratings = [standing.rating for standing in result.standings]
    values = [rating.value for rating in ratings]
    errors = [
        [rating.value - rating.low for rating in ratings],
        [rating.high - rating.value for rating in ratings],
    ]
    axes.errorbar(
        *(values, rows),
        xerr=errors,
        fmt="o",
        color=BLUE,
        ecolor=BLUE,
        elinewidth=1.6,
        capsize=4,
        markersize=6,
    )
    for row, value in zip(rows, values, strict=True):
        axes.annotate(
            f"{value:.1f}",
            (value, row),
            (0, 6),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=INK,
        )
    axes.set_yticks(rows, [short(standing.label) for standing in result.standings])
    axes.set_ylim(len(rows) - 0.4, -0.7)
    axes.set_title("Rating, with 95 % interval", fontsize=10, color=INK)
    axes.grid(axis="x", alpha=0.3)
    axes.margins(x=0.08)
    without_frame(axes)


def _draw_matrix(axes: Any, result: TournamentResult) -> None:
    count = len(result.standings)
    shares = [[result.payoff(one, two) for two in range(count)] for one in range(count)]
    numbers = np.array([[np.nan if s is None else s for s in row] for row in shares], float)
    axes.imshow(numbers, cmap="RdBu", vmin=-0.25, vmax=1.25, aspect="auto")
    for one, row in enumerate(shares):
        for two, share in enumerate(row):
            text = "" if one == two else "-" if share is None else f"{100 * share:.0f}"
            is_dark = share is not None and abs(share - 0.5) > 0.4
            axes.text(
                *(two, one, text),
                ha="center",
                va="center",
                fontsize=8,
                color="white" if is_dark else INK,
            )
    labels = [short(standing.label) for standing in result.standings]
    axes.set_xticks(range(count), labels, rotation=35, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(count), labels)
    axes.set_title("Races in which the row beats the column [%]", fontsize=10, color=INK)
    without_frame(axes)


def _listed(tracks: tuple[str, ...]) -> str:
    return ", ".join(tracks) if len(tracks) <= 4 else f"{len(tracks)} tracks"
