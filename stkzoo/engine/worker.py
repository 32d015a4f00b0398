"""The server of an engine process: starts the engine and serves a program's requests for races.

Where forking is not available, :func:`main` runs in a new interpreter for each race. Children of
the fork server only run a :class:`WorkerServer`.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator, Sequence
from typing import Any

from stkzoo.engine import wire
from stkzoo.engine.process_clone import fork_beside, serve_fork
from stkzoo.engine.race import GameRace, init_engine
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import Snapshot


@contextlib.contextmanager
def connected(descriptor: int, *graphics: str) -> Iterator[socket.socket]:
    """Starts the engine, tells the program that it is ready, and ends this process afterwards.

    Args:
        descriptor: descriptor of the socket to the program.
        *graphics: arguments of :func:`stkzoo.engine.race.init_engine`.
    """
    init_engine(*graphics)
    with socket.socket(fileno=descriptor) as connection:
        wire.send(connection, wire.OK)
        yield connection
    os._exit(0)


def main(descriptor: int) -> None:
    """Serves the program's requests until the program ends.

    Args:
        descriptor: descriptor of the socket to the program.
    """
    with connected(descriptor) as connection:
        WorkerServer(connection).run()


class RequestServer:
    """Serves the requests of one program, one race after another.

    Args:
        connection: socket to the program.
    """

    _race: Any = None

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection

    def run(self) -> None:
        """Serves requests until the program ends."""
        with contextlib.suppress(EOFError, ConnectionError):
            while True:
                self._serve_next()

    def _serve_next(self) -> None:
        try:
            reply = self._serve(*self._next_request())
        except (EOFError, ConnectionError):
            raise
        except Exception as error:  # noqa: BLE001 - the program reports it
            wire.send_error(self._connection, error)
        else:
            if reply is not None:
                wire.send(self._connection, wire.OK, *reply)

    def _next_request(self) -> tuple[bytes, list[bytes]]:
        return wire.receive(self._connection)

    def _serve(self, kind: bytes, frames: list[bytes]) -> Sequence[bytes] | None:
        """Executes a request and returns the frames of the reply; ``None`` for no reply."""
        if kind != wire.BEGIN:
            return self._advance(*frames)
        if self._race is not None:
            self._race.stop()
            self._race = None  # the engine allows another race only after this object is deleted
        return self._begin(RaceSetup.from_json(frames[0]))

    def _begin(self, setup: RaceSetup) -> Sequence[bytes]:
        raise NotImplementedError

    def _advance(self, *frames: bytes) -> Sequence[bytes]:
        raise NotImplementedError


class WorkerServer(RequestServer):
    """Serves the requests of a :class:`stkzoo.engine.session.WorkerSession`.

    Args:
        connection: socket to the program.
        fork_server: process id of the parent if the parent is a fork server. Clones of this
            process become children of the fork server; without one, this process cannot be
            cloned.
    """

    def __init__(self, connection: socket.socket, fork_server: int | None = None) -> None:
        super().__init__(connection)
        self._fork_server = fork_server

    def _next_request(self) -> tuple[bytes, list[bytes]]:
        """Waits for the next request that is not a step; the kernel serves the steps before it.

        The kernel needs a packet socket, which only children of a fork server have.
        """
        serve = self._race.serve if self._race is not None and self._fork_server else None
        if serve is None:
            return super()._next_request()
        return wire.complete(self._connection, serve(self._connection.fileno()))

    def _serve(self, kind: bytes, frames: list[bytes]) -> Sequence[bytes] | None:
        if kind != wire.FORK or self._fork_server is None:
            return super()._serve(kind, frames)
        # The kernel cannot receive files, so they come in a second message.
        _, _, files = wire.receive_with_files(self._connection)
        session = serve_fork(self._connection, files, fork_beside, self._fork_server)
        self._connection = session or self._connection
        return None

    def _begin(self, setup: RaceSetup) -> Sequence[bytes]:
        race = self._race = GameRace(setup)
        return race.begin().to_frames()

    def _advance(self, *frames: bytes) -> Sequence[bytes]:
        snapshot: Snapshot = self._race.step(frames[0])
        return [snapshot.data]
