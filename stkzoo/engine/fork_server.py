"""The fork server: starts the engine once and forks one child for each race.

Each race is the first one of its process, so its results are reproducible bit for bit: the engine
carries hidden random state from one race to the next. Forking the fork server is safe, because it
never runs a race, uses no graphics and has no threads.

The process of a race can clone itself (:mod:`stkzoo.engine.process_clone`). Clones are also
children of the fork server: it ends and reaps them like the others, and they end with it.

The fork server and the program exchange :mod:`stkzoo.engine.wire` messages over one packet socket.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import os
import select
import shutil
import signal
import socket
import time
import traceback

from stkzoo.engine import wire
from stkzoo.engine.process_clone import serve_fork
from stkzoo.engine.race import init_engine
from stkzoo.engine.worker import WorkerServer

_POLL_SECONDS = 0.5
#: Time for a child to end by itself after its connection is closed [s].
_GRACE_SECONDS = 0.2


def main(control_fd: int) -> None:
    """Runs the fork server until its program ends.

    Args:
        control_fd: descriptor of the socket to the program.
    """
    # Programs inherit ignored signals. If SIGCHLD is ignored, the kernel discards the children's
    # wait statuses.
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    control = socket.socket(fileno=control_fd)
    libc = ctypes.CDLL(None)
    _unbuffer_output(libc)
    faulthandler.enable()
    try:
        init_engine()
        _ForkServer(control).run()
    finally:
        shutil.rmtree(os.environ["HOME"], ignore_errors=True)


class _ForkServer:
    def __init__(self, control: socket.socket):
        self._control = control
        self._pid = os.getpid()
        self._program = os.getppid()
        self._statuses: dict[int, int] = {}  # of ended children; the program may request them
        self._dropped: set[int] = set()  # killed children whose status is not needed
        self._names: dict[int, bytes] = {}  # of living children that are no clones

    def run(self) -> None:
        """Serves the program's requests until the program ends."""
        poller = select.poll()
        poller.register(self._control, select.POLLIN)
        try:
            with contextlib.suppress(EOFError, ConnectionError):
                while os.getppid() == self._program:
                    if poller.poll(_POLL_SECONDS * 1000):
                        self._serve_request()
                    self._reap()
        finally:
            for pid in self._names:  # a child that is stopped at its start would remain
                _kill(pid)

    def _serve_request(self) -> None:
        kind, frames, files = wire.receive_with_files(self._control)
        if kind == wire.FORK:
            self._fork(frames[0], files)
            return
        pid = self._pid_of(frames[0])
        if kind == wire.END:
            status = None if pid is None else self._end(pid)
            reply = b"" if status is None else str(status).encode()
            wire.send(self._control, wire.OK, frames[0], reply)
        elif pid is not None:
            self._drop(pid)

    def _pid_of(self, child: bytes) -> int | None:
        """Returns the process id of a child from its id or name."""
        if child.isdigit():
            return int(child)
        return next((pid for pid, name in self._names.items() if name == child), None)

    def _fork(self, name: bytes, files: list[int]) -> None:
        try:
            session = serve_fork(self._control, files, lambda: self._fork_named(name), self._pid)
            if session is None:
                return
            WorkerServer(session, fork_server=self._pid).run()
            os._exit(0)
        except BaseException:
            traceback.print_exc()
            if os.getpid() != self._pid:  # the child must not run the fork server's code
                os._exit(1)
            raise

    def _fork_named(self, name: bytes) -> int:
        pid = os.fork()
        if pid:
            self._names[pid] = name
        return pid

    def _end(self, pid: int) -> int | None:
        """Ends a child; kills it after :data:`_GRACE_SECONDS`.

        Returns:
            The wait status of the child; ``None`` if there is no such process.
        """
        deadline = time.monotonic() + _GRACE_SECONDS
        self._reap()
        while pid not in self._statuses:
            if time.monotonic() > deadline and not _kill(pid):
                return None
            time.sleep(0.001)
            self._reap()
        return self._statuses.pop(pid)

    def _drop(self, pid: int) -> None:
        """Ends a child without waiting for it."""
        if self._statuses.pop(pid, None) is None and _kill(pid):
            self._dropped.add(pid)

    def _reap(self) -> None:
        with contextlib.suppress(ChildProcessError):
            while (child := os.waitpid(-1, os.WNOHANG))[0]:
                pid, status = child
                self._names.pop(pid, None)
                if pid in self._dropped:
                    self._dropped.discard(pid)
                else:
                    self._statuses[pid] = status


def _kill(pid: int) -> bool:
    """Kills a process; returns whether it exists. An ended child exists until it is reaped."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def _unbuffer_output(libc: ctypes.CDLL) -> None:
    """Turns off C's output buffers, so the log is complete even if the game crashes."""
    with contextlib.suppress(ValueError):  # some C libraries name their streams differently
        stdout = ctypes.c_void_p.in_dll(libc, "stdout")
        libc.setvbuf(stdout, None, 2, 0)  # 2 is _IONBF
