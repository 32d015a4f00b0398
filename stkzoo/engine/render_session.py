"""The client of the render process, which draws a race that runs in another process."""

from __future__ import annotations

import ctypes.util
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine import wire
from stkzoo.engine.process import DRAWING_START_TIMEOUT, SpawnedProcess, explain_os_errors
from stkzoo.engine.session import CallTurn, ProcessSession
from stkzoo.engine.setup import RaceSetup
from stkzoo.errors import ConfigError, EngineCrashed

#: Default game time between two poses of the drawn karts [s].
TICK = 1 / 60

#: Debian packages that drawing without a display needs.
GRAPHICS_PACKAGES = "libegl1 libgl1 libgl1-mesa-dri"


#: Time limits for the images of one moment, and for the first images, because shaders are slow
#: without a graphics card [s].
_TIMEOUT, _FIRST_TIMEOUT = 30.0, 300.0

#: Disables this filter, with which Mesa's software renderer can hang for a minute.
_NO_ANISOTROPY = "-GL_EXT_texture_filter_anisotropic -GL_ARB_texture_filter_anisotropic"


@dataclass(frozen=True, slots=True)
class Footage:
    """The camera images of one moment.

    Attributes:
        images: ``(C, H, W, 3)`` uint8, one image per camera; empty if none was requested.
        depths: ``(C, H, W)`` float32, the raw depth buffer: 0 is near and 1 is far; empty if none
            was requested.
        locations: ``(K, 3)`` float32: locations of the drawn karts [m].
    """

    images: npt.NDArray[np.uint8]
    depths: npt.NDArray[np.float32]
    locations: npt.NDArray[np.float32]


def missing_graphics_libraries() -> list[str]:
    """Returns the libraries for drawing without a display that the system lacks (Linux only)."""
    if sys.platform != "linux":
        return []
    return [f"lib{name}" for name in ("EGL", "GL") if ctypes.util.find_library(name) is None]


def check_graphics_libraries() -> None:
    """Checks that the libraries for drawing without a display are installed (Linux only).

    Raises:
        ConfigError: libraries are missing; the message names the packages.
    """
    if missing := missing_graphics_libraries():
        raise ConfigError(
            f"the game's pictures need {' and '.join(missing)}, which this machine does not have; "
            f"on Debian and Ubuntu `sudo apt install {GRAPHICS_PACKAGES}`, or draw the map with "
            'render_backend="map"'
        )


def has_graphics_card() -> bool:
    """Returns whether the machine has a graphics card.

    Without one, an image in high quality takes minutes. Systems other than Linux are not checked
    and return ``True``.
    """
    if sys.platform != "linux":
        return True
    names = ("dri/renderD*", "nvidia[0-9]*", "dxg")
    return any(True for name in names for _ in Path("/dev").glob(name))


class RenderSession(ProcessSession):
    """A session that draws races in a separate process, one at a time.

    Args:
        root: folder of the game's full data.
        size: width and height of an image [pixels].
        preset: graphics quality: ``"ld"``, ``"sd"`` or ``"hd"``, or a mapping of fields of
            ``pystk2.GraphicsConfig``.
        has_window: show the game's window; otherwise the game draws off screen.
    """

    def __init__(
        self,
        root: Path,
        size: tuple[int, int],
        preset: str | dict[str, Any] = "ld",
        *,
        has_window: bool = False,
    ) -> None:
        fields: dict[str, Any] = {"preset": preset} if isinstance(preset, str) else dict(preset)
        fields |= {"render": True, "display": has_window}
        fields |= {"screen_width": size[0], "screen_height": size[1]}
        super().__init__(
            "the render process",
            "`stkzoo doctor` looks for the cause",
            {wire.BEGIN: DRAWING_START_TIMEOUT},
        )
        self._root, self._graphics = root, json.dumps(fields)
        self._has_window = has_window
        self._turn = CallTurn()

    def start(self, setup: RaceSetup) -> None:
        """Starts the race to draw, with its karts on the grid.

        Args:
            setup: options of the race.

        Raises:
            EngineError: the game cannot draw on this machine; the error has its last output.
        """
        if self._process is not None and self._process.owner != os.getpid():
            self.close()
        is_new = self._process is None
        if is_new:
            with explain_os_errors():
                self._process = SpawnedProcess(self._root, "render_process", self._variables())
            self._timeouts[wire.DRAW] = _FIRST_TIMEOUT
        try:
            self._request(wire.BEGIN, setup.to_json())
        except EngineCrashed as error:
            if not (is_new and self._has_window):
                raise
            raise EngineCrashed(
                "the game could not open its window; check that the display exists that "
                "DISPLAY or WAYLAND_DISPLAY names, start one with `xvfb-run`, or use "
                'render_mode="rgb_array"',
                error.log,
            ) from None

    def draw(
        self,
        poses: npt.NDArray[np.float32],
        *,
        seconds: float = TICK,
        images: bool = True,
        depths: bool = False,
        in_real_time: bool = False,
    ) -> Footage:
        """Moves the karts through a sequence of poses and draws the last one.

        Args:
            poses: ``(T, K, 8)``: pose of each kart: location [m], rotation (w, x, y, z),
                speed [m/s].
            seconds: game time between two poses [s].
            images: return the images.
            depths: return the depth buffers.
            in_real_time: take at least as long as the game time.

        Raises:
            ApiOrderError: no race was started.
            EngineError: the game crashed or does not answer.
        """
        wishes = {
            "seconds": seconds,
            "images": images,
            "depths": depths,
            "in_real_time": in_real_time,
        }
        moments = np.ascontiguousarray(poses, np.float32).tobytes()
        request = json.dumps(wishes).encode()
        shapes, *blocks = self._request(wire.DRAW, request, moments)
        self._timeouts[wire.DRAW] = _TIMEOUT
        kinds: tuple[type[Any], ...] = np.uint8, np.float32, np.float32
        parts = zip(blocks, kinds, json.loads(shapes), strict=True)
        return Footage(*(np.frombuffer(data, dtype).reshape(shape) for data, dtype, shape in parts))

    def _request(self, tag: bytes, *data: bytes) -> list[bytes]:
        with self._turn:
            try:
                self._send(tag, *data)
                return self._receive(tag)
            finally:
                if self._asked is not None:
                    # Interrupted: the next request would get this request's reply.
                    self.close()

    def _variables(self) -> dict[str, str]:
        variables = {"STKZOO_GRAPHICS": self._graphics}
        if sys.platform == "linux":
            if not has_graphics_card():
                variables["MESA_EXTENSION_OVERRIDE"] = _NO_ANISOTROPY
            offscreen = {"SDL_VIDEODRIVER": "offscreen"}
            variables |= _window_variables() if self._has_window else offscreen
        return variables


def _window_variables() -> dict[str, str]:
    """Returns the environment variables that open the window on the user's display."""
    systems = {"DISPLAY": "x11", "WAYLAND_DISPLAY": "wayland"}
    named = ",".join(system for name, system in systems.items() if os.environ.get(name))
    variables = {"SDL_VIDEODRIVER": os.environ.get("SDL_VIDEODRIVER") or named}
    # The X server's key is in the user's home, but the game has its own home.
    key = os.environ.get("XAUTHORITY") or os.path.expanduser("~/.Xauthority")
    return {**variables, "XAUTHORITY": key} if Path(key).is_file() else variables
