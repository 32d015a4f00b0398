"""Pictures of the race that an environment runs, by the game or as a map."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.errors import AssetError, ConfigError, EngineError
from stkzoo.names import CameraMode
from stkzoo.render.game import GameView
from stkzoo.render.map import MapView
from stkzoo.render.pictures import tiled
from stkzoo.render.scene import Scene

logger = logging.getLogger(__name__)

Picture = npt.NDArray[np.uint8]

#: What draws: the game, the map, or the game if it can and else the map.
BACKENDS = ("auto", "engine", "map")


class RaceRenderer:
    """Draws the moments of one race after another.

    The render process starts with the first picture.

    Args:
        backend: one of :data:`BACKENDS`.
        size: width and height of a picture [pixels].
        preset: how finely the game draws (:class:`~stkzoo.engine.render_session.RenderSession`).
        has_window: the game's window shows the race.
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
        self._game_karts: tuple[int, ...] = ()
        self._is_game_ready = False
        self._maps: dict[int | None, MapView] = {}  # by the kart that it follows

    @property
    def backend(self) -> str:
        """What draws: ``"engine"`` or ``"map"``; ``"auto"`` until the first picture."""
        return self._backend

    def begin(self, scene: Scene) -> None:
        """Starts another race."""
        self._scene, self._is_game_ready = scene, False
        self._maps = {}

    def follow(self, scene: Scene) -> None:
        """Starts another race if the scene is another one."""
        if scene != self._scene:
            self.begin(scene)

    def remember(self, snapshot: Snapshot) -> None:
        """Records a moment for the trails of the map, even if it is not drawn."""
        if self._backend == "map":
            for view in self._maps.values():
                view.remember(snapshot)
            self._map(None, snapshot)

    def picture(self, snapshot: Snapshot) -> Picture:
        """One picture of the race, ``(H, W, 3)`` uint8.

        By the game: what the camera sees, or all cameras as tiles. On the map: all of it.

        Raises:
            EngineError: the game cannot draw, or died.
        """
        with self._drawing() as game:
            if game is None:
                return self._map(None, snapshot).draw(snapshot)
            by_kart = game.frames(snapshot)
        frames = [by_kart[kart] for kart in camera_karts(self._current())]
        return tiled(frames, self.size) if len(frames) > 1 else frames[0]

    def pictures(self, snapshot: Snapshot) -> dict[int, Picture]:
        """A picture for each kart with a camera, ``(H, W, 3)`` uint8.

        On the map, the picture follows the kart.

        Raises:
            EngineError: the game cannot draw, or died.
        """
        with self._drawing() as game:
            if game is not None:
                return game.frames(snapshot)
        karts = camera_karts(self._current())
        return {kart: self._map(kart, snapshot).draw(snapshot) for kart in karts}

    def pictures_and_depths(
        self, snapshot: Snapshot
    ) -> tuple[dict[int, Picture], dict[int, npt.NDArray[np.float32]]]:
        """By the game: the pictures and depth buffers by kart; 0 is near, 1 far.

        Raises:
            ConfigError: the map draws, which has no depth.
            EngineError: the game cannot draw, or died.
        """
        with self._drawing() as game:
            if game is not None:
                return game.frames_and_depths(snapshot)
        raise ConfigError('the map has no depth; draw with the game, render_backend="engine"')

    def pictures_between(self, snapshot: Snapshot, number: int) -> Iterator[dict[int, Picture]]:
        """By the game: what the cameras see at so many moments after the last picture.

        There is one moment only after a leap in time, and none when the map draws.
        """
        with self._drawing() as game:
            if game is not None:
                yield from game.frames_between(snapshot, number)

    def show(self, snapshot: Snapshot) -> None:
        """Brings the window to this moment."""
        with self._drawing() as game:
            if game is not None:
                game.show(snapshot)

    def close(self) -> None:
        """Ends the render process, if there is one, and the race."""
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
        """The map around a kart, or of the whole track."""
        if kart not in self._maps:
            self._maps[kart] = MapView(self._current(), self.size, follow=kart, panel=kart is None)
            self._maps[kart].remember(snapshot)
        return self._maps[kart]

    @contextlib.contextmanager
    def _drawing(self) -> Iterator[GameView | None]:
        """The game, drawing the current race; ``None`` if the map draws.

        A failure closes the game; the next picture starts it again.
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
        if self._game is None or self._game_karts != tuple(sorted(karts)):
            self._end_game()
            self._game = GameView(karts, self.size, self._preset, has_window=self._has_window)
            self._game_karts = tuple(sorted(karts))
        if not self._is_game_ready:
            self._game.start(self._current())
            self._is_game_ready = True


def camera_karts(scene: Scene) -> list[int]:
    """The karts with a camera, in the order of their agents.

    These are the agents that request one; then, up to ``num_cameras``, the others except
    those that refuse one; and the first agent if there is no other.
    """
    modes = {kart: scene.setup.karts[kart].camera_mode for kart in scene.kart_indices}
    chosen = [kart for kart, mode in modes.items() if mode == CameraMode.ON]
    for kart, mode in modes.items():
        if mode == CameraMode.AUTO and len(chosen) < scene.setup.num_cameras:
            chosen.append(kart)
    shown = [kart for kart in modes if kart in chosen][:_MOST_CAMERAS]
    return shown or list(scene.kart_indices[:1])


_MOST_CAMERAS = 8
