"""The game's own frames of a race, drawn by its shadow (:mod:`stkzoo.engine.shadow`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.assets import find_assets
from stkzoo.engine.filming import TICK, Footage, ShadowSession, check_graphics_libraries
from stkzoo.engine.setup import KartSetup, RaceSetup
from stkzoo.engine.snapshot import Snapshot
from stkzoo.names import CameraMode
from stkzoo.render.motion import game_time, poses_between
from stkzoo.render.scene import Scene
from stkzoo.render.tiles import resized

__all__ = ["GameView"]

Picture = npt.NDArray[np.uint8]

#: After a longer way the karts are put in place at once, and the cameras given time [s].
_LONGEST_WAY = 0.5
_SETTLING_TICKS = 20
#: The game splits its screen for so many cameras into cells of another shape than the
#: screen's, and each picture has the cell's view: a screen larger by this much (width,
#: height) mends the shape.
_MENDS = {2: (1.0, 2.0), 5: (1.5, 1.0), 6: (1.5, 1.0)}
#: Models that are easy to tell apart, for karts whose model nobody has chosen.
_MODELS = (
    *("tux", "gnu", "nolok", "kiki", "konqi", "suzanne", "wilber", "puffy"),
    *("sara_the_racer", "pidgin", "adiumy", "amanda", "emule", "gavroche", "hexley", "beastie"),
)


class GameView:
    """Draws the moments of races as the game shows them, off-screen or in its window.

    Args:
        karts: whose cameras, as indices in grid order, at most 8.
        size: width and height of a picture [pixels].
        preset: see :class:`~stkzoo.engine.filming.ShadowSession`.
        has_window: shows the game's window.

    Raises:
        AssetError: the game's full data is missing.
        ConfigError: graphics libraries are missing.
    """

    def __init__(
        self,
        karts: Sequence[int],
        size: tuple[int, int] = (640, 480),
        preset: str | dict[str, Any] = "ld",
        *,
        has_window: bool = False,
    ) -> None:
        if not has_window:
            check_graphics_libraries()
        self._assets = find_assets(graphics=True)
        self._karts, self._size = sorted(karts), size
        mend = _MENDS.get(len(karts), (1.0, 1.0))
        screen = round(size[0] * mend[0]), round(size[1] * mend[1])
        self._session = ShadowSession(self._assets.root, screen, preset, has_window=has_window)
        self._last: Snapshot | None = None

    def start(self, scene: Scene) -> None:
        """Starts drawing a race.

        Raises:
            EngineError: the game cannot draw here.
        """
        self._session.start(_drawn_setup(scene, self._karts, self._assets.karts))
        self._last = None

    def frames(self, snapshot: Snapshot) -> dict[int, Picture]:
        """The frame of each camera, ``(H, W, 3)`` uint8, by its kart.

        Raises:
            EngineError: the game died or hangs.
        """
        return self._frames(self._go(snapshot, images=True).images)

    def depths(self, snapshot: Snapshot) -> dict[int, npt.NDArray[np.float32]]:
        """The depth buffer of each camera, by its kart; near is 0 and far is 1."""
        depths = self._go(snapshot, images=False, depths=True).depths
        return dict(zip(self._karts, depths, strict=True))

    def show(self, snapshot: Snapshot) -> None:
        """Moves the karts in the window."""
        self._go(snapshot, images=False)

    def frames_between(self, snapshot: Snapshot, number: int) -> Iterator[dict[int, Picture]]:
        """The frames of so many moments after the last one drawn; the last is ``snapshot``."""
        last = self._last
        if last is None or not 0 < game_time(snapshot) - game_time(last) <= _LONGEST_WAY:
            yield self.frames(snapshot)
            return
        ticks = max(1, round((game_time(snapshot) - game_time(last)) / TICK / number))
        fractions = np.arange(1, number * ticks + 1, dtype=np.float32) / (number * ticks)
        poses = poses_between(last, snapshot, fractions)
        self._last = snapshot
        for begin in range(0, len(poses), ticks):
            yield self._frames(self._session.draw(poses[begin : begin + ticks]).images)

    def close(self) -> None:
        """Ends the process that draws."""
        self._session.close()

    def _go(self, snapshot: Snapshot, *, images: bool, depths: bool = False) -> Footage:
        poses = self._way_to(snapshot)
        self._last = snapshot
        return self._session.draw(poses, images=images, depths=depths)

    def _way_to(self, snapshot: Snapshot) -> npt.NDArray[np.float32]:
        last = self._last
        seconds = game_time(snapshot) - game_time(last) if last is not None else np.inf
        if last is snapshot:
            return poses_between(snapshot, snapshot, np.ones(0, np.float32))
        if last is None or not 0 < seconds <= _LONGEST_WAY:
            return poses_between(snapshot, snapshot, np.ones(_SETTLING_TICKS, np.float32))
        ticks = max(1, round(seconds / TICK))
        return poses_between(last, snapshot, np.arange(1, ticks + 1, dtype=np.float32) / ticks)

    def _frames(self, images: Picture) -> dict[int, Picture]:
        pictures = [resized(image, self._size) for image in images]
        return dict(zip(self._karts, pictures, strict=True))


def _drawn_setup(scene: Scene, cameras: Sequence[int], models: Sequence[str]) -> RaceSetup:
    worn = _models(scene, models)
    karts = [
        KartSetup(
            is_bot=False,
            kart=worn[kart],
            color=setup.color,
            camera_mode=int(CameraMode.ON if kart in cameras else CameraMode.OFF),
        )
        for kart, setup in enumerate(scene.setup.karts)
    ]
    return replace(scene.setup, karts=tuple(karts), num_cameras=len(cameras))


def _models(scene: Scene, known: Sequence[str]) -> list[str]:
    """What each kart looks like: the model that was asked for, else one of its own."""
    chosen = [kart.kart for kart in scene.setup.karts]
    free = [model for model in _MODELS if model in known and model not in chosen]
    free = free or list(known)
    agents = [*scene.kart_indices, *range(scene.num_kart)]
    order = list(dict.fromkeys(kart for kart in agents if not chosen[kart]))
    for number, kart in enumerate(order):
        chosen[kart] = free[number % len(free)]
    return chosen
