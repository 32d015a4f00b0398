"""How the game draws itself, as a plain value that the engine's process understands."""

from __future__ import annotations

import json
import os
import sys
from typing import Any

from stkzoo.errors import ConfigError, unknown_name

__all__ = ["graphics_setting"]

_PRESETS = ("ld", "sd", "hd")


def graphics_setting(render_mode: str | None, choice: Any) -> str:
    """The setting for :func:`stkzoo.engine.race.init_engine`.

    Args:
        render_mode: ``None`` for headless.
        choice: ``None`` for the best preset, a preset's name, or a ``GraphicsConfig``.

    Raises:
        ConfigError: the choice cannot be, or there is no display.
    """
    if choice is not None and not hasattr(choice, "screen_width") and choice not in _PRESETS:
        raise unknown_name("graphics_config", choice, _PRESETS)
    if render_mode is None:
        return "none"
    if sys.platform == "linux" and not _has_display():
        raise ConfigError(
            f"render_mode is {render_mode!r}, but neither DISPLAY nor WAYLAND_DISPLAY names a "
            "display; start a desktop session or `xvfb-run`, or use render_mode=None"
        )
    if choice is None or isinstance(choice, str):
        return choice or "hd"
    names = [name for name in dir(choice) if not name.startswith("_")]
    values = {name: getattr(choice, name) for name in names}
    plain = {k: v for k, v in values.items() if isinstance(v, (bool, int, float))}
    return json.dumps(plain)


def _has_display() -> bool:
    names = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    return any(os.environ.get(name) for name in names)
