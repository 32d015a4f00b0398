"""Renders the race of an environment, with the game or as a map."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.setup import MAX_CAMERAS
from stkzoo.engine.snapshot import Snapshot
from stkzoo.errors import AssetError, ConfigError, EngineError
from stkzoo.names import CameraMode
from stkzoo.render.game import GameView
from stkzoo.render.map import MapView
from stkzoo.render.pictures import Picture, tiled
from stkzoo.render.scene import Scene

logger = logging.getLogger(__name__)

#: The render backends; ``"auto"`` is the game if it can render, otherwise the map.
BACKENDS = ("auto", "engine", "map")


class RaceRenderer:
    """Renders the moments of one race after another.

    The render process starts with the first frame.

    Args:
        backend: one of :data:`BACKENDS`.
        size: width and height of a frame [pixels].
        preset: graphics settings (:class:`~stkzoo.engine.render_session.RenderSession`).
        has_window: whether to show the race in the game's window.
    """

    def __init__(
        self,
        backend: str = "auto",
        size: tuple[int, int] = (640, 480),
        preset: str | dict[str, Any] = "ld",
        *,
        has_window: bool = False,
    ) -> None:
        self.size = size
        self._backend, self._preset, self._has_window = backend, preset, has_window
        self._scene: Scene | None = None
        self._game: GameView | None = None
        self._is_game_ready = False
        self._maps: dict[int | None, MapView] = {}  # by followed kart

    @property
    def backend(self) -> str:
        """Backend in use: ``"engine"`` or ``"map"``; ``"auto"`` before the first frame."""
        return self._backend

    def begin(self, scene: Scene) -> None:
        """Starts to render a new race."""
        self._scene, self._is_game_ready = scene, False
        self._maps = {}

    def follow(self, scene: Scene) -> None:
        """Starts to render a new race if the scene has changed."""
        if scene != self._scene:
            self.begin(scene)

    def remember(self, snapshot: Snapshot) -> None:
        """Records a snapshot for the map's trails without drawing it."""
        if self._backend == "map":
            for view in self._maps.values():
                view.remember(snapshot)
            self._map(None, snapshot)

    def picture(self, snapshot: Snapshot) -> Picture:
        """Returns one frame of the race, ``(H, W, 3)`` uint8.

        With the game: the camera's view, or the views of all cameras as tiles. On the map: the
        whole track.

        Raises:
            EngineError: the game cannot render, or crashed.
        """
        by_kart = self.game_pictures(snapshot)
        if by_kart is None:
            return self._map(None, snapshot).draw(snapshot)
        frames = [by_kart[kart] for kart in camera_karts(self._current())]
        return tiled(frames, self.size) if len(frames) > 1 else frames[0]

    def pictures(self, snapshot: Snapshot) -> dict[int, Picture]:
        """Returns a frame for each kart with a camera, ``(H, W, 3)`` uint8.

        On the map, the frame follows the kart.

        Raises:
            EngineError: the game cannot render, or crashed.
        """
        by_kart = self.game_pictures(snapshot)
        if by_kart is not None:
            return by_kart
        karts = camera_karts(self._current())
        return {kart: self._map(kart, snapshot).draw(snapshot) for kart in karts}

    def game_pictures(self, snapshot: Snapshot) -> dict[int, Picture] | None:
        """Returns the game's frame for each kart with a camera; ``None`` if the map is drawn.

        Raises:
            EngineError: the game cannot render, or crashed.
        """
        with self._drawing() as game:
            return None if game is None else game.draw(snapshot)[0]

    def pictures_and_depths(
        self, snapshot: Snapshot
    ) -> tuple[dict[int, Picture], dict[int, npt.NDArray[np.float32]]]:
        """Returns the game's frames and depth buffers by kart; 0 is near, 1 is far.

        Raises:
            ConfigError: the backend is the map, which has no depth.
            EngineError: the game cannot render, or crashed.
        """
        with self._drawing() as game:
            if game is not None:
                return game.draw(snapshot, depths=True)
        raise ConfigError('the map has no depth; draw with the game, render_backend="engine"')

    def show(self, snapshot: Snapshot) -> None:
        """Updates the window to this snapshot."""
        with self._drawing() as game:
            if game is not None:
                game.show(snapshot)

    def close(self) -> None:
        """Stops the render process, if there is one, and forgets the race."""
        self._scene = None
        self._end_game()

    def _end_game(self) -> None:
        game, self._game, self._is_game_ready = self._game, None, False
        if game is not None:
            game.close()

    def _current(self) -> Scene:
        assert self._scene is not None  # noqa: S101 - callers begin first
        return self._scene

    def _map(self, kart: int | None, snapshot: Snapshot) -> MapView:
        """Returns the map that follows a kart, or the map of the whole track."""
        if kart not in self._maps:
            self._maps[kart] = MapView(self._current(), self.size, follow=kart, panel=kart is None)
            self._maps[kart].remember(snapshot)
        return self._maps[kart]

    @contextlib.contextmanager
    def _drawing(self) -> Iterator[GameView | None]:
        """Yields the game's view of the current race; ``None`` if the backend is the map.

        If rendering fails, the game is closed; the next frame starts it again.
        """
        if self._backend != "map":
            try:
                self._start_game()
                self._backend = "engine"
            except (AssetError, ConfigError, EngineError) as error:
                self._end_game()
                if self._backend == "engine" or self._has_window:
                    raise
                logger.warning("the game cannot draw here, the map is drawn instead: %s", error)
                self._backend = "map"
        try:
            yield self._game
        except EngineError:
            self._end_game()
            raise

    def _start_game(self) -> None:
        karts = camera_karts(self._current())
        if self._game is None or self._game.karts != sorted(karts):
            self._end_game()
            self._game = GameView(karts, self.size, self._preset, has_window=self._has_window)
        if not self._is_game_ready:
            self._game.start(self._current())
            self._is_game_ready = True


def camera_karts(scene: Scene) -> list[int]:
    """Returns the karts with a camera, in the order of their agents.

    These are the agents that request one; then, up to ``num_cameras``, other agents that do not
    refuse one; and the first agent if there is no other.
    """
    modes = {kart: scene.setup.karts[kart].camera_mode for kart in scene.kart_indices}
    chosen = [kart for kart, mode in modes.items() if mode == CameraMode.ON]
    for kart, mode in modes.items():
        if mode == CameraMode.AUTO and len(chosen) < scene.setup.num_cameras:
            chosen.append(kart)
    shown = [kart for kart in modes if kart in chosen][:MAX_CAMERAS]
    return shown or list(scene.kart_indices[:1])
