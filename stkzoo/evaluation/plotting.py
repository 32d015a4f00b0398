"""The shared style of all plots."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo._imports import import_extra
from stkzoo._os import write_whole
from stkzoo.errors import ConfigError
from stkzoo.evaluation.statistics import Estimate

INK, BLUE, GRAY = "#22303c", "#2f6db5", "#8a949c"
#: Colors of several series in one plot.
PALETTE = (BLUE, "#d1762b", "#3b8f5a", "#8a5bb0", "#b23b4e", "#5b6f7d")
_MAX_LABEL = 18
#: Fonts that systems have, for names that matplotlib's own font cannot write.
_FALLBACK_FONTS = (
    "Noto Sans CJK JP",
    "WenQuanYi Micro Hei",
    "Droid Sans Fallback",
    "Arial Unicode MS",
    "Microsoft YaHei",
    "Malgun Gothic",
)


def require_matplotlib(alternative: str = "") -> Any:
    """Imports ``matplotlib.figure``.

    Args:
        alternative: alternative in the error text, such as ``"or pass --no-plot"``.

    Raises:
        ConfigError: matplotlib is not installed.
    """
    return import_extra("matplotlib.figure", "the plot needs", "races", alternative)


def new_figure(width: float, height: float) -> Any:
    """Returns an empty ``matplotlib`` figure.

    Args:
        width: width of the figure [inches].
        height: height of the figure [inches].

    Raises:
        ConfigError: matplotlib is not installed.
    """
    return require_matplotlib().Figure(figsize=(width, height), layout="constrained")


def style_axes(axes: Any, title: str | None = None) -> None:
    """Removes the frame and tick marks of axes, and sets their title.

    Args:
        axes: the ``matplotlib`` axes.
        title: the title; ``None`` leaves it unchanged.
    """
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
    """Draws estimates as points with horizontal intervals.

    Args:
        axes: the ``matplotlib`` axes.
        estimates: the estimates by row.
        scale: factor for all values.
        color: color of the points and intervals.
        label: label in the legend.
    """
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
        # A legend leaves out labels that begin with _.
        label=f" {label}" if label and label.startswith("_") else label,
    )
    axes.grid(axis="x", alpha=0.3)


def shorten(label: str) -> str:
    """Shortens a label to at most 18 characters, which fit beside a plot."""
    return label if len(label) <= _MAX_LABEL else label[: _MAX_LABEL - 3] + "..."


def _fallback_fonts() -> list[str]:
    """Returns the installed fonts among :data:`_FALLBACK_FONTS`."""
    manager = import_extra("matplotlib.font_manager", "the plot needs", "races")
    installed = {*manager.get_font_names()}
    return [name for name in _FALLBACK_FONTS if name in installed]


def save_figure(figure: Any, path: str | os.PathLike[str]) -> None:
    """Writes a figure to a file, atomically. The same figure always makes the same file.

    Args:
        figure: the ``matplotlib`` figure.
        path: the file; its suffix selects the format, ``.png`` by default.

    Raises:
        ConfigError: the file cannot be written.
    """
    file = Path(path)
    ending = file.suffix[1:] or "png"
    metadata = {"Date": None} if ending == "svg" else None
    matplotlib = import_extra("matplotlib", "the plot needs", "races")
    fixed_ids = matplotlib.rc_context({"svg.hashsalt": "stkzoo"})
    for text in figure.findobj(matplotlib.text.Text):
        if "$" in text.get_text():  # a name of an agent, not a formula
            text.set_parse_math(False)
        if not text.get_text().isascii():
            text.set_fontfamily([*text.get_fontfamily(), *_fallback_fonts()])
    with write_whole(file, "the plot") as part, fixed_ids, warnings.catch_warnings():
        # No installed font has the letters of some names; boxes are drawn instead.
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        try:
            figure.savefig(part, format=ending, dpi=110, metadata=metadata)
        except ValueError as error:  # unknown format
            raise ConfigError(f"the plot {file} cannot be written: {error}") from error
