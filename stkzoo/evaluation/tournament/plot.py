"""Plots a tournament: ratings with intervals, and who beats whom."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from stkzoo.evaluation.plotting import (
    INK,
    draw_intervals,
    new_figure,
    save_figure,
    shorten,
    style_axes,
)

if TYPE_CHECKING:
    from stkzoo.evaluation.tournament.plan import TournamentResult


def plot_tournament(result: TournamentResult, path: str | os.PathLike[str]) -> None:
    """Plots a tournament into a file, atomically.

    Args:
        result: the tournament.
        path: the file; its ending selects the format, such as ``.png`` or ``.svg``.

    Raises:
        ConfigError: matplotlib is not installed, or the file cannot be written.
    """
    count = len(result.standings)
    figure = new_figure(5.6 + 0.55 * count + 3, 2.2 + 0.42 * count)
    ratings, matrix = figure.subplots(1, 2, width_ratios=(5.2, 2.4 + 0.62 * count))
    labels = [shorten(standing.label) for standing in result.standings]
    _draw_ratings(ratings, result, labels)
    _draw_matrix(matrix, result, labels)
    tracks = result.plan.tracks
    places = ", ".join(tracks) if len(tracks) <= 4 else f"{len(tracks)} tracks"
    figure.suptitle(
        f"{count} agents, {len(result.races)} races of {result.plan.per_race} on {places}",
        color=INK,
        fontsize=11,
    )
    save_figure(figure, path)


def _draw_ratings(axes: Any, result: TournamentResult, labels: list[str]) -> None:
    rows = range(len(labels))
    ratings = [standing.rating for standing in result.standings]
    values = [rating.value for rating in ratings]
    draw_intervals(axes, rows, values, [rating.interval for rating in ratings])
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
    axes.set_yticks(rows, labels)
    axes.set_ylim(len(rows) - 0.4, -0.7)
    axes.margins(x=0.08)
    style_axes(axes, "Rating, with 95 % interval")


def _draw_matrix(axes: Any, result: TournamentResult, labels: list[str]) -> None:
    agents = range(len(labels))
    shares = [[result.payoff(one, two) for two in agents] for one in agents]
    numbers = np.array([[np.nan if s is None else s for s in row] for row in shares], float)
    axes.imshow(numbers, cmap="RdBu", vmin=-0.25, vmax=1.25, aspect="auto")
    for one, row in enumerate(shares):
        for two, share in enumerate(row):
            text = "" if one == two else "-" if share is None else f"{100 * share:.0f}"
            is_dark = share is not None and abs(share - 0.5) > 0.4
            color = "white" if is_dark else INK
            axes.text(two, one, text, ha="center", va="center", fontsize=8, color=color)
    axes.set_xticks(agents, labels, rotation=35, ha="right", rotation_mode="anchor")
    axes.set_yticks(agents, labels)
    style_axes(axes, "Races in which the row beats the column [%]")
