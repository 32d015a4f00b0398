"""The server of an engine process: starts the engine and serves a program's requests for races.

Where forking is not available, :func:`main` runs in a new interpreter for each race. Children of
the fork server only run a :class:`WorkerServer`.

A child of the fork server is an ordinary fork. A clone of a race must outlive the process
from which it was cloned, and end with the fork server. An ordinary fork would be a child of the
race's process, so the clone is forked as a *sibling*: the system call ``clone`` with
``CLONE_PARENT`` makes it a child of the fork server from the start. The fork server can end and
reap it, and the kernel ends it when the fork server ends. (A fork of a fork, whose orphan the fork
server adopts, does the same but takes twice as long.)

This call skips the preparations of Python and of the C library for a fork. They only matter to
processes with threads. A race without a window has none; :func:`fork_beside` checks this.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import signal
import socket
from collections.abc import Callable, Sequence
from typing import Any

from stkzoo.engine import wire
from stkzoo.engine.race import GameRace, init_engine
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import Snapshot

_PR_SET_PDEATHSIG = 1
_CLONE_PARENT = 0x8000
#: Numbers of the system call ``clone``. Both platforms take the arguments used here in one order.
_SYS_CLONE = {"x86_64": 56, "aarch64": 220}

# Unlike CDLL, PyDLL holds the GIL during a call, so the clone also starts with it.
_libc: Any = ctypes.PyDLL(None, use_errno=True)


def main(descriptor: int) -> None:
    """Starts the engine and serves the program's requests until the program ends.

    Args:
        descriptor: descriptor of the socket to the program.
    """
    init_engine()
    WorkerServer(socket.socket(fileno=descriptor)).run()
    os._exit(0)


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

    def _serve(self, tag: bytes, frames: list[bytes]) -> Sequence[bytes] | None:
        """Executes a request and returns the frames of the reply; ``None`` for no reply."""
        if tag != wire.BEGIN:
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

    def _serve(self, tag: bytes, frames: list[bytes]) -> Sequence[bytes] | None:
        if tag != wire.FORK or self._fork_server is None:
            return super()._serve(tag, frames)
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


def die_with(parent: int) -> None:
    """Makes the kernel kill this process when its parent ends.

    If the parent has already ended, this process exits.

    Args:
        parent: process id of the parent.
    """
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def serve_fork(
    connection: socket.socket, files: Sequence[int], fork: Callable[[], int], fork_server: int
) -> socket.socket | None:
    """Serves the request :data:`~stkzoo.engine.wire.FORK`.

    This process sends the id of the new process over its connection, so the program knows a new
    process that never answers.

    Args:
        connection: the connection of this process; the new process closes it.
        files: descriptors of the new process's connection and log, which this process closes.
        fork: function that forks this process, such as :func:`os.fork`.
        fork_server: process id of the new process's parent.

    Returns:
        The connection of the new process, in the new process; ``None`` in this process.
    """
    session, log = socket.socket(fileno=files[0]), files[1]
    problem = None
    try:
        pid = fork()
    except OSError as error:
        problem = error
    else:
        if not pid:
            die_with(fork_server)
            for stream in (1, 2):
                os.dup2(log, stream)
            os.close(log)
            connection.close()
            return session
    os.close(log)
    with session, contextlib.suppress(OSError):  # the program may have been interrupted
        if problem is None:
            wire.send(session, wire.OK, str(pid).encode())
        else:
            wire.send_error(session, problem)
    return None


def fork_beside() -> int:
    """Forks this process as a sibling: the new process is a child of this process's parent.

    Returns:
        Process id of the new process; 0 in the new process.

    Raises:
        OSError: the system call failed, the platform is not supported, or this process has
            several threads.
    """
    if len(os.listdir("/proc/self/task")) > 1:
        raise OSError("a process with several threads cannot be cloned")
    try:
        clone = _SYS_CLONE[platform.machine()]
    except KeyError:
        raise OSError(f"processes on {platform.machine()} cannot be cloned") from None
    pid: int = _libc.syscall(clone, _CLONE_PARENT | signal.SIGCHLD, 0, 0, 0, 0)
    if pid < 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))
    return pid
