"""Pillow, imported on first use, and grids of images."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from stkzoo._imports import import_extra

if TYPE_CHECKING:
    from PIL import ImageFont

#: An image, ``(H, W, 3)``.
Picture = npt.NDArray[np.uint8]

_IN_NO_FONT, _TRIAL_SIZE = "\uffff", 16


@lru_cache(maxsize=1)
def pillow() -> Any:
    """Returns Pillow's modules ``Image``, ``ImageDraw`` and ``ImageFont`` as attributes.

    Raises:
        ConfigError: Pillow is not installed.
    """
    for name in ("Image", "ImageDraw", "ImageFont"):
        import_extra(f"PIL.{name}", "drawing needs", "races")
    return sys.modules["PIL"]


#: Files of fonts that systems have, for names that Pillow's built-in font (ASCII) cannot write.
FALLBACK_FONTS = (
    "DejaVuSans.ttf",
    "NotoSans-Regular.ttf",
    "arial.ttf",  # Windows
    "Arial Unicode.ttf",  # macOS
    "NotoSansCJK-Regular.ttc",
    "wqy-microhei.ttc",
    "DroidSansFallbackFull.ttf",
    "msyh.ttc",
    "malgun.ttf",
)


def font_of(size: int, text: str = "") -> ImageFont.FreeTypeFont:
    """Returns a font that can write a text.

    Args:
        size: size [pixels].
        text: the text. If no installed font has all of its characters, the font has most of them,
            and draws boxes for the others.
    """
    return _font("" if text.isascii() else _font_file(text), max(6, size))


@lru_cache(maxsize=256)
def _font_file(text: str) -> str:
    """Returns the first font file that lacks the fewest characters; empty for the built-in font."""
    files = ("", *_installed(FALLBACK_FONTS))
    return min(files, key=lambda file: _num_missing(text, _font(file, _TRIAL_SIZE)))


@lru_cache(maxsize=1)
def _installed(files: tuple[str, ...]) -> tuple[str, ...]:
    """Returns the installed ones of font files. For each other one, Pillow searches all folders."""
    installed: list[str] = []
    for file in files:
        with suppress(OSError):  # not installed
            _font(file, _TRIAL_SIZE)
            installed.append(file)
    return tuple(installed)


@lru_cache(maxsize=64)
def _font(file: str, size: int) -> ImageFont.FreeTypeFont:
    fonts = pillow().ImageFont
    font: ImageFont.FreeTypeFont = fonts.truetype(file, size) if file else fonts.load_default(size)
    return font


def _num_missing(text: str, font: ImageFont.FreeTypeFont) -> int:
    """Counts the characters for which a font draws the same box as for a character of no font."""
    box = [*font.getmask(_IN_NO_FONT)]
    return sum([*font.getmask(character)] == box for character in text)


def fitted_text(text: str, font: ImageFont.FreeTypeFont, room: float) -> str:
    """Returns the text, shortened if it is wider than ``room`` [pixels]."""
    if font.getlength(text) <= room:
        return text
    while text and font.getlength(text + "…") > room:
        text = text[:-1]
    return text + "…"


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
