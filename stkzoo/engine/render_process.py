"""The render process: a second race with graphics, whose karts follow those of another race.

Graphics slightly change the game's physics, so the exact race runs without them. This process has
graphics and its own race. Before it draws an image, it moves its karts to the poses of the exact
race. Rendering therefore never changes a race, and costs nothing while no image is requested.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from stkzoo.engine.race import init_engine, race_config
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.worker import RequestServer

#: Number of values in a pose: location [m], rotation (w, x, y, z), speed [m/s].
_POSE_SIZE = 8
#: Number of laps, large enough that no kart finishes. A finished kart cannot be moved.
_MANY_LAPS = 999
#: Race clock after which karts can be moved [s]; step size until then [s], large because a window
#: draws every step; and the maximum number of these steps.
_FREE_AFTER, _WARMUP_STEP, _MAX_WARMUP_STEPS = 1.01, 0.5, 1000

Poses = npt.NDArray[np.float32]


class MirroredRace:
    """The race that is drawn. A process can have only one at a time.

    Args:
        setup: the race to mirror. A kart has a camera if its ``camera_mode`` is not off.
    """

    def __init__(self, setup: RaceSetup) -> None:
        import pystk2

        self._coast = [pystk2.Action()] * len(setup.karts)
        mirrored = RaceSetup(
            setup.track,
            tuple(replace(kart, is_bot=False) for kart in setup.karts),
            laps=_MANY_LAPS,
            reverse=setup.reverse,
            mode=setup.mode,
            seed=setup.seed,
            step_size=_WARMUP_STEP,
        )
        config = race_config(mirrored, has_cameras=True)
        config.overlay = False
        self._race = pystk2.Race(config)
        self._race.start()
        self._world = pystk2.WorldState()
        self._due = 0.0
        for _ in range(_MAX_WARMUP_STEPS):
            self._race.step(self._coast)
            self._world.update()
            if self._world.time >= _FREE_AFTER:
                break

    def follow(self, poses: Poses, seconds: float, *, in_real_time: bool = False) -> None:
        """Moves the karts through a sequence of poses.

        Args:
            poses: ``(T, K, 8)`` float32: location [m], rotation (w, x, y, z), speed [m/s].
            seconds: game time between two poses [s].
            in_real_time: take at least as long as the game time.
        """
        self._race.config.step_size = seconds
        move = self._world.set_kart_location
        for moment in poses.tolist():
            for kart, (x, y, z, qw, qx, qy, qz, speed) in enumerate(moment):
                move(kart, [x, y, z], [qx, qy, qz, qw], speed)
            self._race.step(self._coast)
            if in_real_time:
                self._wait(seconds)
        self._world.update()

    def _wait(self, seconds: float) -> None:
        """Waits until ``seconds`` after the last pose. Later poses do not catch up on delays."""
        now = time.monotonic()
        self._due = max(self._due + seconds, now)
        time.sleep(min(self._due - now, seconds))

    def draw(self, request: bytes, poses: bytes) -> list[bytes]:
        """Returns the reply to a :data:`~stkzoo.engine.wire.DRAW` request.

        Args:
            request: options as JSON.
            poses: bytes of the poses, as in :meth:`follow`.
        """
        wishes = json.loads(request)
        moments = np.frombuffer(poses, np.float32).reshape(-1, len(self._coast), _POSE_SIZE)
        self.follow(moments, wishes["seconds"], in_real_time=wishes["in_real_time"])
        cameras = self._race.render_data
        images = [camera.image for camera in cameras] if wishes["images"] else ()
        depths = [camera.depth for camera in cameras] if wishes["depths"] else ()
        arrays = (
            np.array(images, np.uint8),
            np.array(depths, np.float32),
            np.array([kart.location for kart in self._world.karts], np.float32),
        )
        shapes = json.dumps([array.shape for array in arrays])
        return [shapes.encode(), *(array.tobytes() for array in arrays)]

    def stop(self) -> None:
        """Ends the race. Do not call any other method afterwards."""
        self._race.stop()


def main(descriptor: int) -> None:
    """Starts the engine and serves the program's drawing requests until the program ends.

    Args:
        descriptor: descriptor of the socket to the program.
    """
    init_engine(os.environ.pop("STKZOO_GRAPHICS"))
    _RenderServer(socket.socket(fileno=descriptor)).run()
    os._exit(0)


class _RenderServer(RequestServer):
    """Serves the requests of a :class:`stkzoo.engine.render_session.RenderSession`."""

    def _serve(self, tag: bytes, frames: list[bytes]) -> Sequence[bytes] | None:
        with _ending_with(self._connection):
            return super()._serve(tag, frames)

    def _begin(self, setup: RaceSetup) -> Sequence[bytes]:
        self._race = MirroredRace(setup)
        return []

    def _advance(self, *frames: bytes) -> Sequence[bytes]:
        reply: list[bytes] = self._race.draw(*frames)
        return reply


@contextlib.contextmanager
def _ending_with(connection: socket.socket) -> Iterator[None]:
    """Ends this process when the program ends. Drawing can take minutes, so it cannot wait."""
    if sys.platform != "linux":
        yield
        return
    import fcntl

    flags = fcntl.fcntl(connection, fcntl.F_GETFL)
    fcntl.fcntl(connection, fcntl.F_SETOWN, os.getpid())
    # With O_ASYNC, the kernel sends SIGIO at the end of the connection, which kills this process.
    fcntl.fcntl(connection, fcntl.F_SETFL, flags | os.O_ASYNC)
    try:
        with contextlib.suppress(BlockingIOError):
            if not connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT):
                raise EOFError
        yield
    finally:
        fcntl.fcntl(connection, fcntl.F_SETFL, flags)
