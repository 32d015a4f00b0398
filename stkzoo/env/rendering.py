"""The part of the parallel core that shows the race."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.env.episode import Episode
from stkzoo.env.graphics import check_render_mode, checked_size, drawing_preset
from stkzoo.errors import ApiOrderError
from stkzoo.render.renderer import RaceRenderer
from stkzoo.render.scene import Scene

Picture = npt.NDArray[np.uint8]


class Rendering:
    """Shows the races of one environment, in the way its render mode asks for.

    Nothing here touches a race: pictures are made from its snapshots.

    Args:
        mode: one of :data:`~stkzoo.env.graphics.RENDER_MODES`, or ``None``.
        backend: what draws: ``"auto"``, ``"engine"`` or ``"map"``.
        size: width and height of a picture [pixels].
        graphics_config: see :func:`~stkzoo.env.graphics.drawing_preset`.

    Raises:
        ConfigError: an argument is invalid.
    """

    def __init__(
        self, mode: str | None, backend: str, size: Sequence[int], graphics_config: Any
    ) -> None:
        check_render_mode(mode, backend)
        self.mode = mode
        preset = drawing_preset(mode, graphics_config)
        self._renderer = RaceRenderer(
            backend, checked_size(size), preset, has_window=mode == "human"
        )
        self._scene: Scene | None = None
        self._shown: Episode | None = None
        self._list: list[Picture] = []

    @property
    def backend(self) -> str:
        """What draws; see :attr:`stkzoo.render.renderer.RaceRenderer.backend`."""
        return self._renderer.backend

    def reset(self, episode: Episode) -> None:
        """An episode has begun."""
        self._list.clear()
        self._scene = self._shown = None
        self.follow(episode)

    def follow(self, episode: Episode) -> None:
        """The episode has come to a new moment."""
        if self.mode is None:
            return
        self._turn_to(episode)
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
        self._turn_to(episode)
        return self._renderer.picture(episode.snapshot)

    def frames(self, episode: Episode | None, agents: Sequence[str]) -> dict[str, Picture]:
        """The picture of each agent that has a camera."""
        episode = _running(episode, "frames")
        self._turn_to(episode)
        by_kart = self._renderer.pictures(episode.snapshot)
        karts = dict(zip(agents, episode.race.kart_indices, strict=True))
        return {agent: by_kart[kart] for agent, kart in karts.items() if kart in by_kart}

    def close(self) -> None:
        """Ends the render process, if there is one."""
        self._scene = self._shown = None
        self._list.clear()
        self._renderer.close()

    def _turn_to(self, episode: Episode) -> None:
        """Begins another race's pictures when it is another race's moment."""
        if self._shown is not None and self._shown is episode:
            return
        scene = scene_of(episode)
        if self._scene is None or scene != self._scene:
            self._renderer.begin(scene)
            self._scene = scene
        self._shown = episode


def scene_of(episode: Episode) -> Scene:
    """The episode's race as pictures need it."""
    race = episode.race
    return Scene(episode.setup, episode.track_map, race.kart_types, race.kart_indices)


def _running(episode: Episode | None, method: str) -> Episode:
    if episode is None:
        raise ApiOrderError(f"{method}() before reset(); call reset() first")
    return episode
