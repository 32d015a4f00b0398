"""The render process: a second race with graphics, whose karts follow those of another race.

Graphics change the game's physics a little, so the exact race runs without them. Its pictures
come from this process, which has graphics and a race of its own. Before each picture it moves
its karts to the poses of the exact race. Drawing can therefore never change a race, and costs
nothing while no pictures are requested.
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

from stkzoo.engine.race import race_config
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.worker import RequestServer, connected

#: Numbers of a pose: location [m], rotation (w, x, y, z), speed [m/s].
_POSE_SIZE = 8
#: So many laps that no kart finishes: a finished kart cannot be moved.
_MANY_LAPS = 999
#: The race clock from which karts can be moved [s]; how far a step goes until then [s], for
#: a window draws every step; and more steps than that takes.
_FREE_AFTER, _WARMUP_STEP, _MAX_WARMUP_STEPS = 1.01, 0.5, 1000

Poses = npt.NDArray[np.float32]


class MirroredRace:
    """The drawn race. A process can have one at a time.

    Args:
        setup: the race to mirror; the karts whose ``camera_mode`` is on have a camera.
    """

    def __init__(self, setup: RaceSetup) -> None:
        import pystk2

        self._coast = [pystk2.Action()] * len(setup.karts)
        mirrored = RaceSetup(
            setup.track,
            tuple(replace(kart, is_bot=False) for kart in setup.karts),
            laps=_MANY_LAPS,
            reverse=setup.reverse,
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
        """Moves the karts through ``(T, K, 8)`` poses, each ``seconds`` of game time apart [s]."""
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
        """Waits until ``seconds`` after the last pose; delays are not made up for."""
        now = time.monotonic()
        self._due = max(self._due + seconds, now)
        time.sleep(min(self._due - now, seconds))

    def pictures(self) -> npt.NDArray[np.uint8]:
        """What each camera sees: ``(C, H, W, 3)`` uint8."""
        return np.array([camera.image for camera in self._race.render_data], np.uint8)

    def depths(self) -> npt.NDArray[np.float32]:
        """How far each camera sees: ``(C, H, W)`` float32, as the graphics library keeps it."""
        return np.array([camera.depth for camera in self._race.render_data], np.float32)

    def locations(self) -> npt.NDArray[np.float32]:
        """Where the drawn karts are: ``(K, 3)`` [m]."""
        return np.array([kart.location for kart in self._world.karts], np.float32)

    def stop(self) -> None:
        """Ends the race. Do not call anything else afterwards."""
        self._race.stop()


def main(port: int) -> None:
    """Draws for the program until it is gone."""
    with connected(port, os.environ.pop("STKZOO_GRAPHICS")) as connection:
        _RenderServer(connection).run()


class _RenderServer(RequestServer):
    """Serves the requests of a :class:`stkzoo.engine.render_session.RenderSession`."""

    def _serve(self, kind: bytes, frames: list[bytes]) -> Sequence[bytes] | None:
        with _ending_with(self._connection):
            return super()._serve(kind, frames)

    def _begin(self, setup: RaceSetup) -> Sequence[bytes]:
        self._race = MirroredRace(setup)
        return []

    def _advance(self, *frames: bytes) -> Sequence[bytes]:
        return _draw(self._race, *frames)


def _draw(race: MirroredRace, request: bytes, poses: bytes) -> list[bytes]:
    """Answers a :data:`~stkzoo.engine.wire.DRAW`: the request as JSON, and poses."""
    wishes = json.loads(request)
    moments = np.frombuffer(poses, np.float32).reshape(-1, len(race.locations()), _POSE_SIZE)
    race.follow(moments, wishes["seconds"], in_real_time=wishes["in_real_time"])
    arrays = (
        race.pictures() if wishes["images"] else np.empty((0, 0, 0, 3), np.uint8),
        race.depths() if wishes["depths"] else np.empty((0, 0, 0), np.float32),
        race.locations(),
    )
    shapes = json.dumps([array.shape for array in arrays])
    return [shapes.encode(), *(array.tobytes() for array in arrays)]


@contextlib.contextmanager
def _ending_with(connection: socket.socket) -> Iterator[None]:
    """Ends this process if the program ends meanwhile, because drawing can take minutes."""
    if sys.platform != "linux":
        yield
        return
    import fcntl

    flags = fcntl.fcntl(connection, fcntl.F_GETFL)
    fcntl.fcntl(connection, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(connection, fcntl.F_SETFL, flags | os.O_ASYNC)  # a SIGIO at the end, which kills
    try:
        with contextlib.suppress(BlockingIOError):
            if not connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT):
                raise EOFError
        yield
    finally:
        fcntl.fcntl(connection, fcntl.F_SETFL, flags)
