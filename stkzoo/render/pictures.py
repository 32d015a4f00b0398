"""Pillow, loaded when first needed, and several pictures as one."""

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
    """The modules ``Image``, ``ImageDraw`` and ``ImageFont`` of Pillow, as attributes.

    Raises:
        ConfigError: Pillow is not installed.
    """
    for name in ("Image", "ImageDraw", "ImageFont"):
        import_extra(f"PIL.{name}", "drawing needs", "record")
    return sys.modules["PIL"]


@lru_cache(maxsize=64)
def font_of(size: int) -> ImageFont.FreeTypeFont:
    """Pillow's own font in a size [pixels]."""
    font: ImageFont.FreeTypeFont = pillow().ImageFont.load_default(max(6, size))
    return font


Picture = npt.NDArray[np.uint8]


def grid_of(number: int) -> tuple[int, int]:
    """Columns and rows of a grid for so many pictures, about as many of each."""
    columns = math.ceil(math.sqrt(number))
    return columns, math.ceil(number / columns)


def tiled(pictures: Sequence[Picture], size: tuple[int, int]) -> Picture:
    """One picture with all of them, from left to right and top to bottom.

    Args:
        pictures: at least one, ``(h, w, 3)`` uint8 each.
        size: width and height of the whole [pixels].
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
    """The picture in another size; the same if it has that size."""
    if picture.shape[:2] == (size[1], size[0]):
        return picture
    images = pillow().Image
    return np.asarray(images.fromarray(picture).resize(size, images.Resampling.BOX))
