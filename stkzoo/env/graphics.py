"""How races are drawn, as an environment's arguments say it, checked."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

from stkzoo.engine.render_session import has_graphics_card
from stkzoo.errors import ConfigError, unknown_name
from stkzoo.render.renderer import BACKENDS

#: ``None`` draws nothing.
RENDER_MODES = ("human", "rgb_array", "rgb_array_list")

_PRESETS = ("ld", "sd", "hd")
_SMALLEST, _LARGEST = 32, 4096


def check_render_mode(mode: str | None, backend: str) -> None:
    """Checks a render mode and who is to draw.

    Raises:
        ConfigError: they are invalid, or there is no display for a window.
    """
    if mode is not None and not (isinstance(mode, str) and mode in RENDER_MODES):
        raise ConfigError(
            f"render_mode is {mode!r}, expected None or one of {', '.join(RENDER_MODES)}"
        )
    if not (isinstance(backend, str) and backend in BACKENDS):
        raise unknown_name("render_backend", backend, BACKENDS)
    if mode != "human":
        return
    if backend == "map":
        raise ConfigError(
            'render_mode="human" opens the game\'s window, but render_backend is "map"; take '
            'render_mode="rgb_array" for pictures of the map, or another render_backend'
        )
    if sys.platform == "linux" and not _has_display():
        raise ConfigError(
            "render_mode is 'human', but neither DISPLAY nor WAYLAND_DISPLAY names a "
            "display; start a desktop session or `xvfb-run`, or use render_mode=None"
        )


def drawing_preset(mode: str | None, choice: Any) -> str | dict[str, Any]:
    """How finely the game draws, for :class:`stkzoo.engine.render_session.RenderSession`.

    Args:
        mode: the render mode.
        choice: a preset's name, a ``pystk2.GraphicsConfig``, or ``None``: the finest in a
            window if there is a graphics card, else the quickest.

    Raises:
        ConfigError: the choice is invalid.
    """
    if choice is None:
        return "hd" if mode == "human" and has_graphics_card() else "ld"
    if isinstance(choice, str) and choice in _PRESETS:
        return choice
    if not hasattr(choice, "screen_width"):
        raise unknown_name("graphics_config", choice, _PRESETS)
    names = [name for name in dir(choice) if not name.startswith("_")]
    values = {name: getattr(choice, name) for name in names}
    return {name: v for name, v in values.items() if isinstance(v, (bool, int, float))}


def checked_size(size: Sequence[int]) -> tuple[int, int]:
    """Width and height of a picture as Python's own numbers [pixels].

    Raises:
        ConfigError: they are invalid.
    """
    try:
        width, height = (int(side) for side in size)
    except (TypeError, ValueError):
        width = height = 0
    if not all(_SMALLEST <= side <= _LARGEST for side in (width, height)):
        raise ConfigError(
            f"render_size is {size!r}, expected (width, height) from {_SMALLEST} to {_LARGEST} "
            "pixels each, such as (640, 480)"
        )
    return width, height


def frame_rate(step_size: float) -> float:
    """Pictures a second of game time, one a step; whole where it is whole."""
    rate = 1 / step_size
    return round(rate) if abs(rate - round(rate)) < 1e-6 else rate


def _has_display() -> bool:
    names = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    return any(os.environ.get(name) for name in names)
