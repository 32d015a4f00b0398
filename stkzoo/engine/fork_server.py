"""The fork server: starts the engine once and forks one child for each race.

Each race is the first one of its process, so its results are reproducible bit for bit: the engine
carries hidden random state from one race to the next. Forking the fork server is safe, because it
never runs a race, uses no graphics and has no threads.

The process of a race can clone itself (:mod:`stkzoo.engine.worker`). Clones are also
children of the fork server: it ends and reaps them like the others, and they end with it.

The fork server and the program exchange :mod:`stkzoo.engine.wire` messages over one packet socket.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import os
import select
import signal
import socket
import time

from stkzoo.engine import wire
from stkzoo.engine.race import init_engine
from stkzoo.engine.worker import WorkerServer, serve_fork

_POLL_SECONDS = 0.5
#: Time for a child to end by itself after its connection is closed [s].
_GRACE_SECONDS = 0.2


def main(descriptor: int) -> None:
    """Runs the fork server until its program ends, and then ends all its children.

    Args:
        descriptor: descriptor of the socket to the program.
    """
    libc = ctypes.CDLL(None)
    _unbuffer_output(libc)
    faulthandler.enable()
    init_engine()
    _ForkServer(socket.socket(fileno=descriptor)).run()
    os.killpg(0, signal.SIGKILL)  # also ends children that are stopped


class _ForkServer:
    def __init__(self, control: socket.socket):
        self._control = control
        self._program = os.getppid()
        self._statuses: dict[int, int] = {}  # of ended children; the program may request them
        self._dropped: set[int] = set()  # killed children whose status is not needed

    def run(self) -> None:
        """Serves the program's requests until the program ends."""
        poller = select.poll()
        poller.register(self._control, select.POLLIN)
        with contextlib.suppress(EOFError, ConnectionError):
            while os.getppid() == self._program:
                if poller.poll(_POLL_SECONDS * 1000):
                    self._serve_request()
                self._reap()

    def _serve_request(self) -> None:
        tag, frames, files = wire.receive_with_files(self._control)
        if tag == wire.FORK:
            self._fork(files)
        elif tag == wire.END:
            status = self._end(int(frames[0]))
            wire.send(self._control, wire.OK, frames[0], str(status).encode())
        else:
            self._drop(int(frames[0]))

    def _fork(self, files: list[int]) -> None:
        fork_server = os.getpid()
        session = serve_fork(self._control, files, os.fork, fork_server)
        if session is not None:
            try:
                WorkerServer(session, fork_server).run()
            finally:  # the child must not run the fork server's code
                os._exit(0)

    def _end(self, pid: int) -> int:
        """Returns the wait status of a child, which is killed after :data:`_GRACE_SECONDS`."""
        deadline = time.monotonic() + _GRACE_SECONDS
        self._reap()
        while pid not in self._statuses:
            if time.monotonic() > deadline:
                os.kill(pid, signal.SIGKILL)
            time.sleep(0.001)
            self._reap()
        return self._statuses.pop(pid)

    def _drop(self, pid: int) -> None:
        """Ends a child without waiting for it."""
        if self._statuses.pop(pid, None) is None:
            os.kill(pid, signal.SIGKILL)
            self._dropped.add(pid)

    def _reap(self) -> None:
        with contextlib.suppress(ChildProcessError):
            while (child := os.waitpid(-1, os.WNOHANG))[0]:
                pid, status = child
                if pid in self._dropped:
                    self._dropped.discard(pid)
                else:
                    self._statuses[pid] = status


def _unbuffer_output(libc: ctypes.CDLL) -> None:
    """Turns off C's output buffers, so the log is complete even if the game crashes."""
    with contextlib.suppress(ValueError):  # some C libraries name their streams differently
        stdout = ctypes.c_void_p.in_dll(libc, "stdout")
        libc.setvbuf(stdout, None, 2, 0)  # 2 is _IONBF
