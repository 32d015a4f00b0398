"""The part of the parallel core that shows the race, and its arguments checked."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._os import check_display, has_display
from stkzoo.engine.render_session import has_graphics_card
from stkzoo.env.episode import Episode
from stkzoo.errors import ApiOrderError, ConfigError, unknown_name
from stkzoo.render.renderer import BACKENDS, RaceRenderer
from stkzoo.render.scene import Scene
from stkzoo.wrappers.camera import checked_size

#: ``None`` draws nothing.
RENDER_MODES = ("human", "rgb_array", "rgb_array_list")

_PRESETS = ("ld", "sd", "hd")


Picture = npt.NDArray[np.uint8]


class Rendering:
    """Shows the races of one environment, in the way its render mode asks for.

    Nothing here touches a race: pictures are made from its snapshots.

    Args:
        mode: one of :data:`RENDER_MODES`, or ``None``.
        backend: what draws: ``"auto"``, ``"engine"`` or ``"map"``.
        size: width and height of a picture [pixels].
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
        self._list: list[Picture] = []

    @property
    def backend(self) -> str:
        """What draws; see :attr:`stkzoo.render.renderer.RaceRenderer.backend`."""
        return self._renderer.backend

    def check(self) -> None:
        """Checks before a race that it can be shown.

        Raises:
            ConfigError: there is no display for the window.
        """
        if self.mode == "human":
            check_display("render_mode is 'human'", " or render_mode=None")

    def reset(self, episode: Episode) -> None:
        """An episode has begun."""
        self._list.clear()
        self._renderer.begin(scene_of(episode))
        self.follow(episode)

    def follow(self, episode: Episode) -> None:
        """The episode has come to a new moment."""
        if self.mode is None:
            return
        self._renderer.follow(scene_of(episode))
        self._renderer.remember(episode.snapshot)
        if self.mode == "human":
            self._renderer.show(episode.snapshot)
        elif self.mode == "rgb_array_list":
            self._list.append(self._renderer.picture(episode.snapshot))

    def render(self, episode: Episode | None) -> Any:
        """What ``render()`` of an environment gives."""
        if self.mode is None:
            warnings.warn(
                'render() shows nothing without a render mode; pass render_mode="rgb_array" or '
                '"human"',
                stacklevel=3,
            )
            return None
        if self.mode == "human":
            return None
        episode = _running(episode, "render")
        if self.mode == "rgb_array_list":
            frames, self._list = self._list, []
            return frames
        self._renderer.follow(scene_of(episode))
        return self._renderer.picture(episode.snapshot)

    def frames(self, episode: Episode | None, agents: Sequence[str]) -> dict[str, Picture]:
        """The picture of each agent that has a camera."""
        episode = _running(episode, "frames")
        self._renderer.follow(scene_of(episode))
        by_kart = self._renderer.pictures(episode.snapshot)
        karts = dict(zip(agents, episode.race.kart_indices, strict=True))
        return {agent: by_kart[kart] for agent, kart in karts.items() if kart in by_kart}

    def close(self) -> None:
        """Ends the render process, if there is one."""
        self._list.clear()
        self._renderer.close()


def available_modes() -> list[str]:
    """The render modes that work on this machine: without a display there is no window."""
    return [mode for mode in RENDER_MODES if mode != "human" or has_display()]


def scene_of(episode: Episode) -> Scene:
    """The episode's race as pictures need it."""
    race = episode.race
    return Scene(episode.setup, episode.track_map, race.kart_types, race.kart_indices)


def _running(episode: Episode | None, method: str) -> Episode:
    if episode is None:
        raise ApiOrderError(f"{method}() before reset(); call reset() first")
    return episode


def check_render_mode(mode: str | None, backend: str) -> None:
    """Checks a render mode and who is to draw.

    Raises:
        ConfigError: they are invalid.
    """
    if mode is not None and not (isinstance(mode, str) and mode in RENDER_MODES):
        raise ConfigError(
            f"render_mode is {mode!r}, expected None or one of {', '.join(RENDER_MODES)}"
        )
    if not (isinstance(backend, str) and backend in BACKENDS):
        raise unknown_name("render_backend", backend, BACKENDS)
    if mode == "human" and backend == "map":
        raise ConfigError(
            'render_mode="human" opens the game\'s window, but render_backend is "map"; take '
            'render_mode="rgb_array" for pictures of the map, or another render_backend'
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


def frame_rate(step_size: float) -> float:
    """Pictures a second of game time, one a step; whole where it is whole."""
    rate = 1 / step_size
    return round(rate) if abs(rate - round(rate)) < 1e-6 else rate
