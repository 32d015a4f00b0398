"""The engine process's side: starts the engine and serves a program's requests for races.

:func:`main` runs in an interpreter that a program has started for one race, where forking is
not available. Children of the fork server call :func:`serve` alone.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import socket
import traceback
from collections.abc import Iterator

from stkzoo.engine import process_clone, wire
from stkzoo.engine.race import GameRace, init_engine
from stkzoo.engine.setup import RaceSetup


@contextlib.contextmanager
def connected(port: int, graphics: str = "none") -> Iterator[socket.socket]:
    """Starts the engine, connects back to the program, and ends this process afterwards.

    Args:
        port: where the program listens.
        graphics: as in :func:`stkzoo.engine.race.init_engine`.
    """
    token = bytes.fromhex(os.environ.pop("STKZOO_TOKEN"))
    try:
        init_engine(graphics)
        with socket.create_connection(("127.0.0.1", port)) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.sendall(token)
            yield connection
    finally:  # the program may have been killed
        shutil.rmtree(os.environ["HOME"], ignore_errors=True)
    os._exit(0)


def main(port: int, self_destruct_after: int) -> None:
    """Serves the program's requests until it is gone."""
    with connected(port) as connection:
        serve(connection, self_destruct_after=self_destruct_after)


def serve(
    connection: socket.socket, *, self_destruct_after: int, fork_server: int | None = None
) -> None:
    """Serves requests until the program quits or is gone.

    Args:
        connection: socket to the program.
        self_destruct_after: seconds after which a single request that is still running
            ends this process, so that a game that hangs cannot outlive a program that
            can no longer end it. A child of a fork server ends with it instead.
        fork_server: process id of the parent, if that is a fork server. Clones of this process
            become its children; without a fork server this process cannot be cloned.
    """
    race: GameRace | None = None
    has_alarm = fork_server is None
    while True:
        try:
            kind, frames = _next_request(connection, race, fork_server)
            if has_alarm:
                set_alarm(self_destruct_after)
            if kind == wire.ACT and race is not None:
                wire.send(connection, wire.OK, race.step(frames[0]).data)
            elif kind == wire.BEGIN:
                if race is not None:
                    race.stop()
                    race = None  # the engine counts a race until its object is gone
                race = GameRace(RaceSetup.from_json(frames[0]))
                wire.send(connection, wire.OK, *race.begin().to_frames())
            elif kind == wire.FORK and fork_server is not None:
                connection = _fork(connection, fork_server)
            else:
                return
        except (EOFError, ConnectionError):
            return
        except Exception as error:  # noqa: BLE001 - the program reports it
            wire.send(connection, wire.ERROR, describe(error))
        if has_alarm:
            set_alarm(0)


def _next_request(
    connection: socket.socket, race: GameRace | None, fork_server: int | None
) -> tuple[bytes, list[bytes]]:
    """The next request that is not a step; the kernel takes the steps before it.

    Only children of a fork server have a packet socket, and need no alarm.
    """
    if race is None or fork_server is None or not race.can_serve:
        return wire.receive(connection)
    return wire.complete(connection, race.serve(connection))


def _fork(connection: socket.socket, fork_server: int) -> socket.socket:
    """Clones this process; returns the connection to serve, a new one in the clone."""
    wire.send(connection, wire.OK)
    session_fd, log_fd = wire.receive_files(connection, 2)
    try:
        pid = process_clone.fork_beside(fork_server)
    except OSError:
        os.close(session_fd)
        os.close(log_fd)
        raise
    if pid:
        os.close(session_fd)
        os.close(log_fd)
        wire.send(connection, wire.OK, str(pid).encode())
    else:
        connection = process_clone.move_to(connection, session_fd, log_fd)
        wire.send(connection, wire.OK)
    return connection


def set_alarm(seconds: int) -> None:
    """Ends this process after ``seconds``, where the system can; 0 cancels it."""
    if hasattr(signal, "alarm"):
        signal.alarm(seconds)


def describe(error: Exception) -> bytes:
    """The error that is being handled, as the content of a reply of kind ``ERROR``."""
    return json.dumps(
        {
            "type": type(error).__name__,
            "message": str(error),
            "traceback": traceback.format_exc(),
        }
    ).encode()
