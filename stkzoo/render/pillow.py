"""The one place where the drawing library is loaded."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

from stkzoo.errors import ConfigError

if TYPE_CHECKING:
    from PIL import ImageFont

__all__ = ["font_of", "pillow"]


@lru_cache(maxsize=1)
def pillow() -> Any:
    """The modules ``Image``, ``ImageDraw`` and ``ImageFont`` of Pillow, as attributes.

    Raises:
        ConfigError: Pillow is not installed.
    """
    try:
        import PIL
        from PIL import Image, ImageDraw, ImageFont  # noqa: F401 - read as attributes
    except ImportError:
        raise ConfigError(
            "drawing needs Pillow, which is not installed; run `pip install 'stkzoo[record]'`"
        ) from None
    return PIL


@lru_cache(maxsize=64)
def font_of(size: int) -> ImageFont.FreeTypeFont:
    """Pillow's own font in a size [pixels]."""
    font: ImageFont.FreeTypeFont = pillow().ImageFont.load_default(max(6, size))
    return font
