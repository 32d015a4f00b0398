"""The fork server: starts the engine once and forks one child for each race.

Every child is the first race of its process, which is what makes a race repeat bit for
bit (the engine carries hidden random state from one race to the next). The fork server has
never run a race, holds no graphics and runs no threads, so that forking it is safe.

A race's process can clone itself (:mod:`stkzoo.engine.process_clone`). Clones are children of
the fork server too: it ends and reaps them like all others once the program has reported them.

The fork server talks with the program over one packet socket: each packet is a JSON object,
and file descriptors carry the child's socket and log file. A reply repeats the number of its
request, so the program discards a late reply to an interrupted request.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import json
import os
import select
import shutil
import signal
import socket
import time
import traceback
from typing import Any, NoReturn

from stkzoo.engine import process_clone
from stkzoo.engine.race import init_engine
from stkzoo.engine.worker import serve

#: The fork server's first packet: the engine has started.
READY = b"ready"

_POLL_SECONDS = 0.5
#: Time for a child to end by itself after its connection broke [s].
_GRACE_SECONDS = 0.2


def main(control_fd: int, self_destruct_after: int) -> None:
    """Runs until the program at the other end of ``control_fd`` is gone."""
    control = socket.socket(fileno=control_fd)
    libc = ctypes.CDLL(None)
    _unbuffer_output(libc)
    faulthandler.enable()
    try:
        init_engine()
        control.send(READY)
        _ForkServer(control, self_destruct_after).run()
    finally:
        shutil.rmtree(os.environ["HOME"], ignore_errors=True)


class _ForkServer:
    def __init__(self, control: socket.socket, self_destruct_after: int):
        self._control = control
        self._pid = os.getpid()
        self._self_destruct_after = self_destruct_after
        self._program = os.getppid()
        self._living: set[int] = set()
        self._statuses: dict[int, int] = {}  # of ended children that may be requested
        self._dropped: set[int] = set()  # living children whose status is not needed

    def run(self) -> None:
        """Serves the program's requests; ends all children when the program is gone."""
        poller = select.poll()
        poller.register(self._control, select.POLLIN)
        while os.getppid() == self._program:
            if poller.poll(_POLL_SECONDS * 1000) and not self._serve_request():
                break
            self._reap()
        for pid in self._living:
            os.kill(pid, signal.SIGKILL)

    def _serve_request(self) -> bool:
        data, fds, _, _ = socket.recv_fds(self._control, 65536, 2)
        if not data:
            return False
        request: dict[str, Any] = json.loads(data)
        if request["do"] == "fork":
            self._reply(request, **self._try_to_fork(fds))
        elif request["do"] == "end":
            self._reply(request, status=self._end(request["pid"]))
        elif request["do"] == "drop":
            self._drop(request["pid"])
        elif request["do"] == "adopt":
            self._adopt(request["pid"])
        return True

    def _reply(self, request: dict[str, Any], **values: int | str | None) -> None:
        self._control.send(json.dumps({"number": request["number"], **values}).encode())

    def _try_to_fork(self, fds: list[int]) -> dict[str, Any]:
        """Forks a child, or says why it failed; the other children go on."""
        problem = "the game's fork server may open no more files"
        if len(fds) == 2:
            try:
                return {"pid": self._fork(*fds)}
            except OSError as error:
                problem = str(error)
        for fd in fds:
            os.close(fd)
        return {"pid": None, "error": problem}

    def _fork(self, session_fd: int, log_fd: int) -> int:
        pid = os.fork()
        if pid == 0:
            self._run_child(session_fd, log_fd)
        os.close(session_fd)
        os.close(log_fd)
        self._living.add(pid)
        return pid

    def _run_child(self, session_fd: int, log_fd: int) -> NoReturn:
        status = 1
        try:
            process_clone.die_with(self._pid)
            session = process_clone.move_to(self._control, session_fd, log_fd)
            serve(session, self_destruct_after=self._self_destruct_after, fork_server=self._pid)
            status = 0
        except BaseException:  # noqa: BLE001 - nothing of the fork server may run in the child
            traceback.print_exc()
        finally:
            os._exit(status)

    def _adopt(self, pid: int) -> None:
        """Registers a clone that a child has made of itself."""
        with contextlib.suppress(ChildProcessError):  # it has ended and was reaped
            ended, status = os.waitpid(pid, os.WNOHANG)
            if ended:
                self._statuses[pid] = status
            else:
                self._living.add(pid)

    def _end(self, pid: int) -> int | None:
        """Ends a child; returns its wait status, ``None`` for an unknown child."""
        deadline = time.monotonic() + _GRACE_SECONDS
        while pid in self._living and time.monotonic() < deadline:
            self._reap()
            time.sleep(0.001)
        if pid in self._living:
            os.kill(pid, signal.SIGKILL)
            self._statuses[pid] = os.waitpid(pid, 0)[1]
            self._living.discard(pid)
        return self._statuses.pop(pid, None)

    def _drop(self, pid: int) -> None:
        """Ends a child without waiting for it."""
        if pid in self._living:
            os.kill(pid, signal.SIGKILL)
            self._dropped.add(pid)
        self._statuses.pop(pid, None)

    def _reap(self) -> None:
        while True:
            try:
                pid, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                return
            if not pid:
                return
            # Others are clones that were never reported; their status is not needed.
            if pid in self._living and pid not in self._dropped:
                self._statuses[pid] = status
            self._living.discard(pid)
            self._dropped.discard(pid)


def _unbuffer_output(libc: ctypes.CDLL) -> None:
    """Makes the game's own output reach the log even if the game dies."""
    with contextlib.suppress(ValueError):  # a C library with other names for its streams
        stdout = ctypes.c_void_p.in_dll(libc, "stdout")
        libc.setvbuf(stdout, None, 2, 0)  # 2 is _IONBF
