"""The style that all plots share."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo._os import write_whole
from stkzoo.errors import ConfigError, import_extra
from stkzoo.evaluation.statistics import Estimate

INK, BLUE, GREY = "#22303c", "#2f6db5", "#8a949c"
#: Colours of several series in one plot.
PALETTE = (BLUE, "#d1762b", "#3b8f5a", "#8a5bb0", "#b23b4e", "#5b6f7d")
_MAX_LABEL = 18


def require_matplotlib(extra: str = "benchmark", alternative: str = "") -> Any:
    """Imports ``matplotlib.figure``.

    Args:
        extra: the extra of the package that installs it.
        alternative: what the user can do without it, such as ``"pass --no-plot"``.

    Raises:
        ConfigError: matplotlib is not installed.
    """
    return import_extra("matplotlib.figure", "the plot needs", extra, alternative)


def new_figure(width: float, height: float) -> Any:
    """An empty ``matplotlib`` figure; sizes in inches.

    Raises:
        ConfigError: matplotlib is not installed.
    """
    return require_matplotlib().Figure(figsize=(width, height), layout="constrained")


def style_axes(axes: Any, title: str | None = None) -> None:
    """Removes frame and tick marks, and sets the title."""
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.tick_params(length=0, colors=INK, labelsize=9)
    if title is not None:
        axes.set_title(title, fontsize=10, color=INK)


def draw_intervals(
    axes: Any,
    estimates: Mapping[float, Estimate],
    *,
    scale: float = 1.0,
    color: str = BLUE,
    label: str | None = None,
) -> None:
    """Draws a point with a horizontal interval in each row, at a multiple of the estimates."""
    values = scale * np.array([estimate.value for estimate in estimates.values()])
    ends = scale * np.array([estimate.interval for estimate in estimates.values()]).reshape(-1, 2)
    axes.errorbar(
        values,
        list(estimates),
        xerr=np.maximum((values - ends[:, 0], ends[:, 1] - values), 0.0),
        fmt="o",
        color=color,
        elinewidth=1.6,
        capsize=3,
        markersize=5,
        label=label,
    )
    axes.grid(axis="x", alpha=0.3)


@contextmanager
def two_panels(
    path: str | os.PathLike[str], title: str, width: float, height: float, ratios: Sequence[float]
) -> Iterator[Any]:
    """Yields two axes side by side, whose figure is written when the block ends.

    Args:
        path: the file; its ending selects the format, such as ``.png`` or ``.svg``.
        title: above both.
        width: of the figure [inches].
        height: of the figure [inches].
        ratios: of the widths of the axes.

    Raises:
        ConfigError: matplotlib is not installed, or the file cannot be written.
    """
    figure = new_figure(width, height)
    yield figure.subplots(1, 2, width_ratios=ratios)
    figure.suptitle(title, color=INK, fontsize=11)
    save_figure(figure, path)


def shorten(label: str) -> str:
    """Cuts a label to the length that fits beside a plot."""
    return label if len(label) <= _MAX_LABEL else label[: _MAX_LABEL - 3] + "..."


def save_figure(figure: Any, path: str | os.PathLike[str]) -> None:
    """Writes a figure atomically; the file name's ending selects the format.

    Raises:
        ConfigError: the file cannot be written.
    """
    file = Path(path)
    with write_whole(file, "the plot") as part:
        try:
            figure.savefig(part, format=file.suffix[1:] or "png", dpi=110)
        except ValueError as error:  # of an unknown format
            raise ConfigError(f"the plot {file} cannot be written: {error}") from error
