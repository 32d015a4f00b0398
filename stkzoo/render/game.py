"""The game's own frames of a race, from the render process."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._temporary import TemporaryFolder
from stkzoo.engine.assets import find_assets
from stkzoo.engine.render_session import TICK, Footage, RenderSession, check_graphics_libraries
from stkzoo.engine.setup import KartSetup, RaceSetup
from stkzoo.engine.snapshot import Snapshot
from stkzoo.names import CameraMode
from stkzoo.render.motion import game_time, poses_between
from stkzoo.render.pictures import Picture, resized
from stkzoo.render.scene import Scene

#: After a longer gap in game time [s], karts jump to their places and cameras get time to settle.
_LONGEST_WAY = 0.5
_SETTLING_STEPS, _SETTLING_STEP = 4, 0.1
#: For these numbers of cameras, the game splits its screen into cells with another aspect ratio
#: than the screen. A screen higher by this factor restores the aspect ratio of the frames.
_HEIGHT_FACTORS = {2: 2.0, 5: 1.5, 6: 1.5}
#: The largest off-screen screen that the game supports [pixels]; for a larger request it falls back
#: to this size, with another aspect ratio.
_LARGEST_SCREEN = 1024, 768
#: Prefixes of the file names of the dials' images.
_DIAL = ("speed", "gauge_")
#: Distinctive kart models, for karts without a chosen model.
_MODELS = (
    *("tux", "gnu", "nolok", "kiki", "konqi", "suzanne", "wilber", "puffy"),
    *("sara_the_racer", "pidgin", "adiumy", "amanda", "emule", "gavroche", "hexley", "beastie"),
)


class GameView:
    """Renders moments of races with the game, off-screen or in a window.

    Args:
        karts: karts with a camera, as indices in grid order, at most 8.
        size: width and height of a frame [pixels].
        preset: see :class:`~stkzoo.engine.render_session.RenderSession`.
        has_window: whether to show the game's window.

    Attributes:
        karts: the karts, sorted.

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
        self.karts, self._size = sorted(karts), size
        screen = size if has_window else _screen_for(size, len(karts))
        root = self._assets.root
        self._data = TemporaryFolder("window") if has_window else None
        if self._data is not None and os.name == "posix":
            _link_without_dial(root, self._data.path)
            root = self._data.path
        self._session = RenderSession(root, screen, preset, has_window=has_window)
        self._last: Snapshot | None = None
        self._pace = TICK  # time per pose in the window [s]

    def start(self, scene: Scene) -> None:
        """Starts to render a race.

        Raises:
            EngineError: the game cannot render on this machine.
        """
        self._session.start(_drawn_setup(scene, self.karts, self._assets.karts))
        self._last = None

    def draw(
        self, snapshot: Snapshot, *, depths: bool = False
    ) -> tuple[dict[int, Picture], dict[int, npt.NDArray[np.float32]]]:
        """Returns frames ``(H, W, 3)`` uint8 and depth buffers ``(H, W)`` float32 by kart.

        Args:
            snapshot: the moment to draw.
            depths: whether to return depth buffers: 0 at the camera, 1 at the horizon.

        Raises:
            EngineError: the game crashed or hung.
        """
        footage = self._go(snapshot, images=True, depths=depths)
        images = [resized(image, self._size) for image in footage.images]
        buffers = [_thinned(depth, self._size) for depth in footage.depths]
        by_kart = dict(zip(self.karts, buffers, strict=True)) if depths else {}
        return dict(zip(self.karts, images, strict=True)), by_kart

    def show(self, snapshot: Snapshot) -> None:
        """Moves the karts in the window, at most in real time.

        A window that renders slowly gets fewer poses.
        """
        seconds = self._seconds_to(snapshot)
        if seconds is None or self._last is None:
            self._go(snapshot, images=False)
            return
        number = min(max(1, round(seconds / self._pace)), max(1, round(seconds / TICK)))
        poses = poses_between(self._last, snapshot, _evenly(number))
        begin, self._last = time.monotonic(), snapshot
        self._session.draw(poses, seconds=seconds / number, images=False, in_real_time=True)
        self._pace = (time.monotonic() - begin) / number

    def close(self) -> None:
        """Stops the render process."""
        self._session.close()
        if self._data is not None:
            self._data.close()

    def _go(self, snapshot: Snapshot, *, images: bool, depths: bool = False) -> Footage:
        """Moves the karts to a moment and draws it."""
        last, seconds = self._last, self._seconds_to(snapshot)
        if last is snapshot:
            poses, pace = poses_between(snapshot, snapshot, _evenly(0)), TICK
        elif last is None or seconds is None:
            settled = np.ones(_SETTLING_STEPS, np.float32)
            poses, pace = poses_between(snapshot, snapshot, settled), _SETTLING_STEP
        else:
            ticks = max(1, round(seconds / TICK))
            poses, pace = poses_between(last, snapshot, _evenly(ticks)), TICK
        self._last = snapshot
        return self._session.draw(poses, seconds=pace, images=images, depths=depths)

    def _seconds_to(self, snapshot: Snapshot) -> float | None:
        """Returns the game time since the last frame [s]; ``None`` after a jump or at first."""
        if self._last is None:
            return None
        seconds = game_time(snapshot) - game_time(self._last)
        return seconds if 0 < seconds <= _LONGEST_WAY else None


def _link_without_dial(root: Path, target: Path) -> None:
    """Makes links to the game's data, with transparent dials.

    In a window, the game shows dials for the speed and the nitro of the drawn karts. The render
    process moves these karts directly, so the dials would stay near zero.

    Args:
        root: folder of the game's full data, a value for ``SUPERTUXKART_DATADIR``.
        target: an existing folder for the links.
    """
    nothing = root / "data/textures/transparence.png"
    for folder in ("data", "data/gui", "data/gui/icons"):
        (target / folder).unlink(missing_ok=True)
        (target / folder).mkdir()
        for entry in os.scandir(root / folder):
            is_dial = entry.name.startswith(_DIAL)
            (target / folder / entry.name).symlink_to(nothing if is_dial else entry.path)


def _thinned(depth: npt.NDArray[np.float32], size: tuple[int, int]) -> npt.NDArray[np.float32]:
    """Resizes a depth buffer by sampling; interpolation would invent depths."""
    height, width = depth.shape
    rows = (np.arange(size[1]) + 0.5) * height / size[1]
    columns = (np.arange(size[0]) + 0.5) * width / size[0]
    return depth[np.ix_(rows.astype(np.intp), columns.astype(np.intp))]


def _screen_for(size: tuple[int, int], cameras: int) -> tuple[int, int]:
    """Returns a screen size whose frames have the wanted aspect ratio and fit the limits."""
    width, height = size[0], size[1] * _HEIGHT_FACTORS.get(cameras, 1.0)
    scale = min(1.0, _LARGEST_SCREEN[0] / width, _LARGEST_SCREEN[1] / height)
    return max(1, round(width * scale)), max(1, round(height * scale))


def _evenly(number: int) -> npt.NDArray[np.float32]:
    """Returns evenly spaced fractions, ``(number,)`` float32; the last one is 1."""
    return np.linspace(0, 1, number + 1, dtype=np.float32)[1:]


def _drawn_setup(scene: Scene, cameras: Sequence[int], models: Sequence[str]) -> RaceSetup:
    worn = _models(scene, models)
    karts = [
        KartSetup(
            is_bot=False,
            kart=worn[kart],
            color=setup.color,
            name=setup.name,
            camera_mode=int(CameraMode.ON if kart in cameras else CameraMode.OFF),
        )
        for kart, setup in enumerate(scene.setup.karts)
    ]
    return replace(scene.setup, karts=tuple(karts))


def _models(scene: Scene, known: Sequence[str]) -> list[str]:
    """Returns each kart's model: the requested one, or a distinct one."""
    chosen = [kart.kart for kart in scene.setup.karts]
    free = [model for model in _MODELS if model in known and model not in chosen]
    free = free or list(known)
    agents = [*scene.kart_indices, *range(scene.num_kart)]
    order = list(dict.fromkeys(kart for kart in agents if not chosen[kart]))
    for number, kart in enumerate(order):
        chosen[kart] = free[number % len(free)]
    return chosen
