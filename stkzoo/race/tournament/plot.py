"""A tournament as a picture: ratings with intervals, and who beats whom."""

from __future__ import annotations

import importlib
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo.errors import ConfigError
from stkzoo.race.tournament.result import TournamentResult

__all__ = ["plot_library", "save_plot"]

_INK, _BLUE, _GREY = "#22303c", "#2f6db5", "#8a949c"
_SHORT = 18


def plot_library() -> Any:
    """The library's figures.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        return importlib.import_module("matplotlib.figure")
    except ImportError as error:
        raise ConfigError(
            f"the plot needs the library matplotlib ({error}); pip install "
            "'stkzoo[tournament]', or leave the plot out (--no-plot)"
        ) from error


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
    figure = plot_library().Figure(figsize=(5.6 + 0.55 * count + 3, height), layout="constrained")
    ratings, matrix = figure.subplots(1, 2, width_ratios=(5.2, 2.4 + 0.62 * count))
    _draw_ratings(ratings, result)
    _draw_matrix(matrix, result)
    num_races = len(result.races)
    figure.suptitle(
        f"{count} agents, {num_races} races of {result.plan.per_race} on "
        f"{_listed(result.plan.tracks)}",
        color=_INK,
        fontsize=11,
    )
    _save(figure, Path(path))


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
        color=_BLUE,
        ecolor=_BLUE,
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
            color=_INK,
        )
    axes.set_yticks(rows, [_short(standing.label) for standing in result.standings])
    axes.set_ylim(len(rows) - 0.4, -0.7)
    axes.set_title("Rating, with 95 % interval", fontsize=10, color=_INK)
    axes.grid(axis="x", alpha=0.3)
    axes.margins(x=0.08)
    _without_frame(axes)


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
                color="white" if is_dark else _INK,
            )
    labels = [_short(standing.label) for standing in result.standings]
    axes.set_xticks(range(count), labels, rotation=35, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(count), labels)
    axes.set_title("Races in which the row beats the column [%]", fontsize=10, color=_INK)
    _without_frame(axes)


def _without_frame(axes: Any) -> None:
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.tick_params(length=0, colors=_INK, labelsize=9)


def _short(label: str) -> str:
    return label if len(label) <= _SHORT else label[: _SHORT - 3] + "..."


def _listed(tracks: tuple[str, ...]) -> str:
    return ", ".join(tracks) if len(tracks) <= 4 else f"{len(tracks)} tracks"


def _save(figure: Any, file: Path) -> None:
    name = ""
    try:
        handle, name = tempfile.mkstemp(prefix=f".{file.name}.", suffix=".part", dir=file.parent)
        os.close(handle)
        figure.savefig(name, format=file.suffix[1:] or "png", dpi=110)
        os.chmod(name, 0o644)
        os.replace(name, file)
    except (OSError, ValueError) as error:
        raise ConfigError(f"the plot {file} cannot be written: {error}") from error
    finally:
        if name:
            Path(name).unlink(missing_ok=True)
