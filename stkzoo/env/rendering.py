"""Rendering of the parallel environment's race, and the checks of its arguments."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._checks import check_name, unknown_name
from stkzoo._os import check_display, display_problem
from stkzoo.engine.render_session import has_graphics_card
from stkzoo.env.episode import Episode
from stkzoo.errors import ApiOrderError, ConfigError
from stkzoo.render.renderer import BACKENDS, RaceRenderer
from stkzoo.render.scene import Scene
from stkzoo.wrappers.camera import checked_size

#: The render modes; ``None`` disables rendering.
RENDER_MODES = ("human", "rgb_array")

_PRESETS = ("ld", "sd", "hd")


Picture = npt.NDArray[np.uint8]


class Rendering:
    """Renders the races of one environment according to its render mode.

    Frames are made from snapshots, so rendering does not affect the race.

    Args:
        mode: one of :data:`RENDER_MODES`, or ``None``.
        backend: renderer: ``"auto"``, ``"engine"`` or ``"map"``.
        size: width and height of a frame [pixels].
        graphics_config: see :func:`drawing_preset`.

    Raises:
        ConfigError: an argument is invalid.
    """

    def __init__(
        self, mode: str | None, backend: str, size: Sequence[int], graphics_config: Any
    ) -> None:
        check_render_mode(mode, backend)
        self.mode = mode
        preset = drawing_preset(mode, graphics_config)
        pixels = checked_size(size, "render_size")
        self._renderer = RaceRenderer(backend, pixels, preset, has_window=mode == "human")

    @property
    def backend(self) -> str:
        """Renderer in use; see :attr:`stkzoo.render.renderer.RaceRenderer.backend`."""
        return self._renderer.backend

    def check(self) -> None:
        """Checks that the next race can be rendered.

        Raises:
            ConfigError: there is no display for the window.
        """
        if self.mode == "human":
            check_display("render_mode is 'human'", " or render_mode=None")

    def reset(self, episode: Episode) -> None:
        """Prepares for a new episode."""
        self._renderer.begin(scene_of(episode))
        self.follow(episode)

    def follow(self, episode: Episode) -> None:
        """Updates the window, or the trails on the map, after a step."""
        if self.mode is None:
            return
        self._renderer.follow(scene_of(episode))
        self._renderer.remember(episode.snapshot)
        if self.mode == "human":
            self._renderer.show(episode.snapshot)

    def render(self, episode: Episode | None) -> Any:
        """Returns the result of the environment's ``render()``."""
        if self.mode is None:
            warnings.warn(
                'render() shows nothing without a render mode; pass render_mode="rgb_array" or '
                '"human"',
                stacklevel=3,
            )
            return None
        if self.mode == "human":
            return None
        if episode is None:
            raise ApiOrderError("render() before reset(); call reset() first")
        self._renderer.follow(scene_of(episode))
        return self._renderer.picture(episode.snapshot)

    def frames(self, episode: Episode, agents: Sequence[str]) -> dict[str, Picture]:
        """Returns the frame of each agent that has a camera."""
        self._renderer.follow(scene_of(episode))
        by_kart = self._renderer.pictures(episode.snapshot)
        karts = dict(zip(agents, episode.race.kart_indices, strict=True))
        return {agent: by_kart[kart] for agent, kart in karts.items() if kart in by_kart}

    def close(self) -> None:
        """Stops the render process, if there is one."""
        self._renderer.close()


def available_modes() -> list[str]:
    """Returns the render modes that work on this machine; ``"human"`` needs a display."""
    return [mode for mode in RENDER_MODES if mode != "human" or not display_problem()]


def scene_of(episode: Episode) -> Scene:
    """Returns the episode's race in the form that renderers use."""
    race = episode.race
    return Scene(episode.setup, episode.track_map, race.kart_types, race.kart_indices)


def check_render_mode(mode: str | None, backend: str) -> None:
    """Checks a render mode and a render backend.

    Raises:
        ConfigError: either is invalid.
    """
    if mode is not None and not (isinstance(mode, str) and mode in RENDER_MODES):
        raise ConfigError(
            f"render_mode is {mode!r}, expected None or one of {', '.join(RENDER_MODES)}"
        )
    check_name("render_backend", backend, BACKENDS)
    if mode == "human" and backend == "map":
        raise ConfigError(
            'render_mode="human" opens the game\'s window, but render_backend is "map"; use '
            'render_mode="rgb_array" for pictures of the map, or another render_backend'
        )


def drawing_preset(mode: str | None, choice: Any) -> str | dict[str, Any]:
    """Returns the graphics settings for :class:`stkzoo.engine.render_session.RenderSession`.

    Args:
        mode: the render mode.
        choice: name of a preset, a ``pystk2.GraphicsConfig``, or ``None``. ``None`` selects the
            highest quality for a window on a machine with a graphics card, otherwise the fastest
            preset.

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


def frame_rate(step_size: float) -> float:
    """Returns the number of frames per second of game time, one per step; an ``int`` if whole."""
    rate = 1 / step_size
    return round(rate) if abs(rate - round(rate)) < 1e-6 else rate
