"""A second race that the game draws, in which karts are put where another race has them.

The game's graphics change its physics a little, so a race that is to be exact runs without
them. Its pictures come from here: a process with graphics and a race of its own, whose karts
are moved to the poses of the exact race before each picture. Drawing can therefore never
change a race, and costs nothing while nobody looks.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import traceback
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine import wire
from stkzoo.engine.race import init_engine
from stkzoo.engine.setup import RaceSetup

__all__ = ["POSE_SIZE", "TICK", "ShadowRace", "main"]

#: Game time of one move of the shadow's karts [s].
TICK = 1 / 60
#: Numbers of a pose: location [m], rotation (w, x, y, z), speed [m/s].
POSE_SIZE = 8
#: Laps that nobody finishes: a finished kart cannot be moved.
_MANY_LAPS = 999
#: The race clock from which karts can be moved [s], and more ticks than that takes.
_FREE_AFTER, _MAX_WARMUP_TICKS = 1.01, 10_000

Poses = npt.NDArray[np.float32]


class ShadowRace:
    """The drawn race. At most one may live at a time in a process.

    Args:
        setup: the race to shadow; ``num_cameras`` of its first karts with a camera are drawn.
    """

    def __init__(self, setup: RaceSetup) -> None:
        import pystk2

        self._coast = [pystk2.Action()] * len(setup.karts)
        self._race = pystk2.Race(_config(pystk2, setup))
        self._race.start()
        self._world = pystk2.WorldState()
        for _ in range(_MAX_WARMUP_TICKS):
            self._race.step(self._coast)
            self._world.update()
            if self._world.time >= _FREE_AFTER:
                break

    def follow(self, poses: Poses) -> None:
        """Moves the karts through ``(T, K, 8)`` poses, one tick each."""
        move = self._world.set_kart_location
        for moment in poses.tolist():
            for kart, (x, y, z, qw, qx, qy, qz, speed) in enumerate(moment):
                move(kart, [x, y, z], [qx, qy, qz, qw], speed)
            self._race.step(self._coast)
        self._world.update()

    def pictures(self) -> list[npt.NDArray[np.uint8]]:
        """What each camera sees: ``(H, W, 3)`` uint8."""
        return [np.asarray(camera.image, np.uint8) for camera in self._race.render_data]

    def depths(self) -> list[npt.NDArray[np.float32]]:
        """How far each camera sees: ``(H, W)`` float32, as the graphics library keeps it."""
        return [np.asarray(camera.depth, np.float32) for camera in self._race.render_data]

    def locations(self) -> npt.NDArray[np.float32]:
        """Where the drawn karts are: ``(K, 3)`` [m]."""
        return np.array([kart.location for kart in self._world.karts], np.float32)

    def stop(self) -> None:
        """Ends the race; nothing else may be called afterwards."""
        self._race.stop()


def _config(pystk2: Any, setup: RaceSetup) -> Any:
    config = pystk2.RaceConfig(
        num_kart=len(setup.karts), seed=setup.seed, track=setup.track, laps=_MANY_LAPS
    )
    config.reverse = setup.reverse
    config.step_size = TICK
    config.num_cameras = setup.num_cameras
    config.overlay = False
    config.players.clear()
    kinds = pystk2.PlayerConfig
    for kart in setup.karts:
        config.players.append(
            kinds(
                kart=kart.kart,
                controller=kinds.Controller.PLAYER_CONTROL,
                camera_mode=kinds.CameraMode(kart.camera_mode),
                color=kart.color,
            )
        )
    return config


def main(port: int, self_destruct_after: int) -> None:
    """Connects back to the program and draws for it until it is gone."""
    token = bytes.fromhex(os.environ.pop("STKZOO_TOKEN"))
    init_engine(os.environ.pop("STKZOO_GRAPHICS"))
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.sendall(token)
        _serve(connection, self_destruct_after)
    os._exit(0)


def _serve(connection: socket.socket, self_destruct_after: int) -> None:
    race: ShadowRace | None = None
    while True:
        try:
            kind, frames = wire.receive(connection)
            _set_alarm(self_destruct_after)
            if kind == wire.BEGIN:
                if race is not None:
                    race.stop()
                    race = None  # the engine counts a race until its object is gone
                race = ShadowRace(RaceSetup.from_json(frames[0]))
                wire.send(connection, wire.OK)
            elif kind == wire.DRAW and race is not None:
                wire.send(connection, wire.OK, *_draw(race, frames[0]))
            else:
                return
        except (EOFError, OSError):
            return
        except Exception as error:  # noqa: BLE001 - it is the program that must hear of it
            wire.send(connection, wire.ERROR, _describe(error))
        _set_alarm(0)


def _draw(race: ShadowRace, request: bytes) -> list[bytes]:
    """Answers a :data:`~stkzoo.engine.wire.DRAW`: one byte of wishes, then poses."""
    num_kart = len(race.locations())
    poses = np.frombuffer(request, np.float32, offset=4).reshape(-1, num_kart, POSE_SIZE)
    race.follow(poses)
    wishes = request[0]
    images = race.pictures() if wishes & 1 else []
    depths = race.depths() if wishes & 2 else []
    shape = (images or depths)[0].shape[:2] if images or depths else (0, 0)
    facts = {"images": len(images), "depths": len(depths), "height": shape[0], "width": shape[1]}
    return [
        json.dumps(facts).encode(),
        b"".join(image.tobytes() for image in images),
        b"".join(depth.tobytes() for depth in depths),
        race.locations().tobytes(),
    ]


def _set_alarm(seconds: int) -> None:
    if hasattr(signal, "alarm"):
        signal.alarm(seconds)


def _describe(error: Exception) -> bytes:
    return json.dumps(
        {
            "type": type(error).__name__,
            "message": str(error),
            "traceback": traceback.format_exc(),
        }
    ).encode()
