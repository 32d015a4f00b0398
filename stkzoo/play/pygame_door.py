"""The one place where pygame is loaded."""

from __future__ import annotations

import os
import sys
from typing import Any

from stkzoo.errors import ConfigError

__all__ = ["load_pygame"]


def load_pygame() -> Any:
    """The module ``pygame``, able to open a window.

    Raises:
        ConfigError: pygame is not installed, or there is no display.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ImportError:
        raise ConfigError(
            "the window needs pygame, which is not installed; run `pip install 'stkzoo[play]'`"
        ) from None
    # Without a display SDL would draw where nobody sees it.
    if sys.platform == "linux" and not _has_display():
        raise ConfigError(
            "neither DISPLAY nor WAYLAND_DISPLAY names a display for the window; start a desktop "
            "session, or `xvfb-run` where nobody looks"
        )
    return pygame


def _has_display() -> bool:
    names = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    return any(os.environ.get(name) for name in names)
