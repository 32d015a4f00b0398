"""The program's side of the fork server: one connection, and the processes forked through it."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stkzoo._os import LockedTemporaryDirectory
from stkzoo.engine import wire
from stkzoo.engine.fork_server import READY
from stkzoo.engine.process import (
    SELF_DESTRUCT_SECONDS,
    START_TIMEOUT,
    Log,
    RaceProcess,
    SpawnedProcess,
    describe_end,
    engine_environment,
    explain_os_errors,
    spawn_interpreter,
)
from stkzoo.errors import EngineCrashed, EngineError, EngineTimeout


def can_fork() -> bool:
    """Whether races are forked from a fork server (Linux), not spawned."""
    return sys.platform == "linux" and os.environ.get("STKZOO_START_METHOD") != "spawn"


def start_race_process(root: Path) -> RaceProcess:
    """Starts a process that can run races.

    Args:
        root: the game's data, as :attr:`stkzoo.engine.assets.Assets.root`.

    Raises:
        EngineCrashed: the engine could not start.
        EngineTimeout: it took too long to start.
    """
    with explain_os_errors():
        if not can_fork():
            return SpawnedProcess(root, "worker")
        try:
            return start_fork_server(root).fork()
        except EngineCrashed:  # the fork server was killed since it was last used
            return start_fork_server(root).fork()


class ForkServerClient:
    """This program's connection to one fork server."""

    def __init__(self, root: Path) -> None:
        self._log = Log()
        self._home = LockedTemporaryDirectory("home")
        self._lock = threading.Lock()
        self._is_ready = False
        self._number = 0  # of the last request
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._control.settimeout(START_TIMEOUT)
        with theirs:
            self._process = spawn_interpreter(
                "fork_server",
                [theirs.fileno(), SELF_DESTRUCT_SECONDS],
                engine_environment(root, str(self._home.path)),
                self._log,
                pass_fds=[theirs.fileno()],
            )

    def fork(self) -> RaceProcess:
        """A new child that has run no race yet."""
        with contextlib.ExitStack() as on_failure, self._lock:
            ours, theirs, log = _connection_and_log(on_failure)
            with theirs:
                answer = self._ask({"do": "fork"}, [theirs.fileno(), log.fileno()])
            if answer["pid"] is None:
                raise OSError(answer["error"])
            on_failure.pop_all()
        return _ForkedProcess(ours, answer["pid"], log, self)

    def end_child(self, pid: int) -> int | None:
        """Ends a child if it still lives; its wait status, ``None`` if unknown."""
        with contextlib.suppress(EngineCrashed), self._lock:
            status: int | None = self._ask({"do": "end", "pid": pid})["status"]
            return status
        return None

    def drop_child(self, pid: int) -> None:
        """Ends a child without waiting for it."""
        with contextlib.suppress(OSError):
            self._control.send(json.dumps({"do": "drop", "pid": pid}).encode())

    def adopt(self, pid: int) -> None:
        """Reports a clone that one of the fork server's children has made of itself."""
        with contextlib.suppress(OSError):  # a fork server that is gone has ended the clone too
            self._control.send(json.dumps({"do": "adopt", "pid": pid}).encode())

    def close(self) -> None:
        """Ends the fork server and with it all its children."""
        self._control.close()
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._home.close()
        self._log.close()

    def forget(self) -> None:
        """Closes the handles of a fork server that belongs to this process's parent."""
        self._control.close()
        self._process.returncode = 0  # not our child: nothing to wait for
        self._home.release()

    def _ask(self, request: Mapping[str, Any], fds: list[int] | None = None) -> Any:
        """Sends a request and waits for its reply; discards replies to interrupted requests."""
        self._number += 1
        message = json.dumps({"number": self._number, **request}).encode()
        try:
            socket.send_fds(self._control, [message], fds or [])
        except OSError:
            self._fail()
        while True:
            packet = self._receive() or self._fail()
            if packet == READY:
                self._is_ready = True
            elif (answer := json.loads(packet))["number"] == self._number:
                return answer

    def _receive(self) -> bytes:
        try:
            return self._control.recv(65536)
        except TimeoutError:
            _retire(self)
            raise EngineTimeout(
                f"the game's fork server gave no answer in {START_TIMEOUT:.0f} s and was ended",
                self._log.tail(),
            ) from None
        except OSError:
            return b""

    def _fail(self) -> bytes:
        log = self._log.tail()
        what = "is gone" if self._is_ready else "could not start"
        _retire(self)
        raise EngineCrashed(
            f"the game's fork server {what}; `stkzoo doctor` looks for the cause", log
        )


class _ForkedProcess(RaceProcess):
    def __init__(
        self, connection: socket.socket, pid: int, log: Log, fork_server: ForkServerClient
    ) -> None:
        super().__init__(connection, pid, log)
        self._fork_server = fork_server

    def end(self) -> str:
        self.connection.close()
        status = self._fork_server.end_child(self.pid)
        return "was lost" if status is None else describe_end(os.waitstatus_to_exitcode(status))

    def drop(self) -> None:
        self._fork_server.drop_child(self.pid)
        self._free()

    def fork(self) -> RaceProcess:
        with contextlib.ExitStack() as on_failure:
            try:
                ours, theirs, log = _connection_and_log(on_failure)
            except OSError as error:
                raise EngineError(
                    f"there is no room for a clone of the game's process: {error}; close() some "
                    "saved states, or raise the system's limit on open files (ulimit -n)"
                ) from error
            with theirs:
                wire.send(self.connection, wire.FORK)
                self.reply()
                wire.send_files(self.connection, [theirs.fileno(), log.fileno()])
            pid = int(self.reply()[0])
            ours.settimeout(self.connection.gettimeout())
            self._fork_server.adopt(pid)
            on_failure.callback(self._fork_server.drop_child, pid)
            try:
                wire.receive(ours)
            except (EOFError, OSError):
                message = "a clone of the game's process ended before it could answer"
                raise EngineCrashed(message, log.tail()) from None
            on_failure.pop_all()
        return _ForkedProcess(ours, pid, log, self._fork_server)


def _connection_and_log(
    on_failure: contextlib.ExitStack,
) -> tuple[socket.socket, socket.socket, Log]:
    """What a new process needs: both ends of a connection, and a log; closed on a failure."""
    ours, theirs = wire.pair()
    on_failure.callback(ours.close)
    on_failure.callback(theirs.close)
    log = Log()
    on_failure.callback(log.close)
    return ours, theirs, log


_fork_servers: dict[Path, ForkServerClient] = {}
_fork_servers_lock = threading.Lock()


def start_fork_server(root: Path) -> ForkServerClient:
    """This program's fork server for the given game data; does not wait for it."""
    with _fork_servers_lock:
        if root not in _fork_servers:
            with explain_os_errors():
                _fork_servers[root] = ForkServerClient(root)
        return _fork_servers[root]


def _retire(fork_server: ForkServerClient) -> None:
    with _fork_servers_lock:
        for root, known in tuple(_fork_servers.items()):
            if known is fork_server:
                del _fork_servers[root]
    fork_server.close()


@atexit.register
def _close_all() -> None:
    while _fork_servers:
        _fork_servers.popitem()[1].close()


def _forget_all() -> None:
    global _fork_servers_lock
    _fork_servers_lock = threading.Lock()
    while _fork_servers:
        fork_server = _fork_servers.popitem()[1]
        fork_server.forget()
        _forgotten.append(fork_server)


#: Fork servers of the parent process, kept so that their finalizers do not run here.
_forgotten: list[ForkServerClient] = []

if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_all)
