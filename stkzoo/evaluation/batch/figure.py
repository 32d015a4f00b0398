"""Pictures of results."""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import Any

from stkzoo.errors import ConfigError
from stkzoo.whole_file import whole_file

__all__ = ["BLUE", "GREY", "INK", "plot_library", "save_figure", "short", "without_frame"]

INK, BLUE, GREY = "#22303c", "#2f6db5", "#8a949c"
_SHORT = 18


def plot_library(extra: str, way_out: str = ", or leave the plot out (--no-plot)") -> Any:
    """The library's figures.

    Args:
        extra: the extra of the package that has it.
        way_out: what else can be done without it.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        return importlib.import_module("matplotlib.figure")
    except ImportError as error:
        raise ConfigError(
            f"the plot needs the library matplotlib ({error}); pip install "
            f"'stkzoo[{extra}]'{way_out}"
        ) from error


def without_frame(axes: Any) -> None:
    """Takes frame and ticks away."""
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.tick_params(length=0, colors=INK, labelsize=9)


def short(label: str) -> str:
    """A label that fits."""
    return label if len(label) <= _SHORT else label[: _SHORT - 3] + "..."


def save_figure(figure: Any, path: str | os.PathLike[str]) -> None:
    """Writes a figure, whole or not at all; the file's ending says the format.

    Raises:
        ConfigError: it cannot be written.
    """
    file = Path(path)
    try:
        with whole_file(file) as part:
            figure.savefig(part, format=file.suffix[1:] or "png", dpi=110)
    except (OSError, ValueError) as error:
        raise ConfigError(f"the plot {file} cannot be written: {error}") from error
