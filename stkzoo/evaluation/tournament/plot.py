"""Plots of a tournament: ratings with intervals, and head-to-head results."""

from __future__ import annotations

import os
from typing import Any

from stkzoo.evaluation.plotting import (
    INK,
    draw_intervals,
    draw_shares,
    shorten,
    style_axes,
    two_panels,
)
from stkzoo.evaluation.ratings import Rating
from stkzoo.evaluation.tournament.standings import TournamentResult


def plot_tournament(result: TournamentResult, path: str | os.PathLike[str]) -> None:
    """Plots a tournament to a file, which is written atomically.

    Args:
        result: result of the tournament.
        path: the file; its suffix selects the format, such as ``.png`` or ``.svg``.

    Raises:
        ConfigError: matplotlib is not installed, or the file cannot be written.
    """
    count, tracks = len(result.standings), result.plan.tracks
    places = ", ".join(tracks) if len(tracks) <= 4 else f"{len(tracks)} tracks"
    title = f"{count} agents, {len(result.races)} races of {result.plan.grid_size} on {places}"
    size, ratios = (5.6 + 0.55 * count + 3, 2.2 + 0.42 * count), (5.2, 2.4 + 0.62 * count)
    labels = [shorten(standing.label) for standing in result.standings]
    with two_panels(path, title, *size, ratios) as (ratings, matrix):
        _draw_ratings(ratings, result, labels)
        _draw_matrix(matrix, result, labels)


def _draw_ratings(axes: Any, result: TournamentResult, labels: list[str]) -> None:
    ratings: dict[float, Rating] = {
        row: standing.rating for row, standing in enumerate(result.standings)
    }
    draw_intervals(axes, ratings)
    for row, rating in ratings.items():
        axes.annotate(
            f"{rating.value:.1f}",
            (rating.value, row),
            (0, 6),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=INK,
        )
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.4, -0.7)
    axes.margins(x=0.08)
    style_axes(axes, "Rating, with 95% interval")


def _draw_matrix(axes: Any, result: TournamentResult, labels: list[str]) -> None:
    agents = range(len(labels))
    draw_shares(axes, [[result.payoff(one, two) for two in agents] for one in agents], labels)
    style_axes(axes, "Races in which the row beats the column [%]")
