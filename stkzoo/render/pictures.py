"""Pillow, imported on first use, and grids of images."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from stkzoo.errors import import_extra

if TYPE_CHECKING:
    from PIL import ImageFont


@lru_cache(maxsize=1)
def pillow() -> Any:
    """Returns Pillow's modules ``Image``, ``ImageDraw`` and ``ImageFont`` as attributes.

    Raises:
        ConfigError: Pillow is not installed.
    """
    for name in ("Image", "ImageDraw", "ImageFont"):
        import_extra(f"PIL.{name}", "drawing needs", "record")
    return sys.modules["PIL"]


@lru_cache(maxsize=64)
def font_of(size: int) -> ImageFont.FreeTypeFont:
    """Returns Pillow's built-in font in a size [pixels]."""
    font: ImageFont.FreeTypeFont = pillow().ImageFont.load_default(max(6, size))
    return font


def fitted_text(text: str, font: ImageFont.FreeTypeFont, room: float) -> str:
    """Returns the text, shortened if it is wider than ``room`` [pixels]."""
    if font.getlength(text) <= room:
        return text
    while text and font.getlength(text + "…") > room:
        text = text[:-1]
    return text + "…"


Picture = npt.NDArray[np.uint8]


def grid_of(number: int) -> tuple[int, int]:
    """Returns columns and rows of a nearly square grid for ``number`` images."""
    columns = math.ceil(math.sqrt(number))
    return columns, math.ceil(number / columns)


def tiled(pictures: Sequence[Picture], size: tuple[int, int]) -> Picture:
    """Arranges images in a grid, left to right and top to bottom.

    Args:
        pictures: at least one image, ``(h, w, 3)`` uint8 each.
        size: width and height of the result [pixels].

    Returns:
        ``(height, width, 3)`` uint8.
    """
    columns, rows = grid_of(len(pictures))
    width, height = size[0] // columns, size[1] // rows
    whole = np.zeros((size[1], size[0], 3), np.uint8)
    for number, picture in enumerate(pictures):
        row, column = divmod(number, columns)
        box = slice(row * height, (row + 1) * height), slice(column * width, (column + 1) * width)
        whole[box] = resized(picture, (width, height))
    return whole


def resized(picture: Picture, size: tuple[int, int]) -> Picture:
    """Returns the image in another size; the same object if the size already matches."""
    if picture.shape[:2] == (size[1], size[0]):
        return picture
    images = pillow().Image
    return np.asarray(images.fromarray(picture).resize(size, images.Resampling.BOX))
