"""The client of the fork server, and the race processes forked through it."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import signal
import socket
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

from stkzoo.engine import wire
from stkzoo.engine.process import (
    START_TIMEOUT,
    RaceProcess,
    SpawnedProcess,
    describe_end,
    explain_os_errors,
    open_log,
    start_remedy,
    tail,
)
from stkzoo.errors import EngineCrashed, EngineError, EngineTimeout


def can_fork() -> bool:
    """Returns whether races are forked from a fork server (Linux) instead of spawned.

    The environment variable ``STKZOO_START_METHOD=spawn`` disables forking.
    """
    return sys.platform == "linux" and os.environ.get("STKZOO_START_METHOD") != "spawn"


def start_race_process(root: Path) -> RaceProcess:
    """Starts a process that can run races, without waiting for its engine.

    Args:
        root: folder of the game's data, :attr:`stkzoo.engine.assets.Assets.root`.

    Raises:
        EngineCrashed: the fork server could not start.
        EngineTimeout: the fork server took too long to start.
    """
    with explain_os_errors():
        if not can_fork():
            return SpawnedProcess(root, "worker")
        try:
            return start_fork_server(root).fork()
        except EngineCrashed:  # the fork server was killed after its last use
            return start_fork_server(root).fork()


#: Time limit for a fork server to end one of its children [s]. It is only exceeded by a fork server
#: that is stopped (SIGSTOP), which ends the child when it continues.
_END_TIMEOUT = 5.0


class ForkServerClient(SpawnedProcess):
    """This program's handle of one fork server. It does not wait until the fork server is ready.

    Attributes:
        root: folder of the game's data.
        lock: held while a reply of the fork server is due.
    """

    def __init__(self, root: Path) -> None:
        super().__init__(root, "fork_server")
        self.root = root
        self.connection.settimeout(_END_TIMEOUT)
        self.lock = threading.Lock()

    def fork(self) -> RaceProcess:
        """Returns a new child of the fork server that has not run a race yet.

        Raises:
            EngineCrashed: the fork server ended or could not start.
            EngineTimeout: the fork server did not answer in time and was ended.
        """
        error: EngineError
        try:
            return self.fork_from(self.connection, START_TIMEOUT)
        except TimeoutError:
            limit = f"{START_TIMEOUT:.0f} s"
            message = f"the game's fork server did not answer within {limit} and was stopped"
            error = EngineTimeout(message, tail(self.log))
        except (EOFError, ConnectionError):
            log = tail(self.log)
            remedy = start_remedy(log, "`stkzoo doctor` looks for the cause")
            error = EngineCrashed(f"the game's fork server has ended; {remedy}", log)
        _retire(self)
        raise error

    def fork_from(self, source: socket.socket, timeout: float | None) -> RaceProcess:
        """Returns a fork of the fork server or of one of its children.

        If this fails, the new process ends by itself.

        Args:
            source: connection to the process to fork.
            timeout: time limit for the fork [s].

        Raises:
            EngineError: the system cannot start or clone a process now.
            EOFError: the process to fork has ended.
            ConnectionError: as for EOFError.
            TimeoutError: the process to fork did not answer in time.
        """
        with contextlib.ExitStack() as on_failure:
            with explain_os_errors():
                ours, other_end = map(on_failure.enter_context, wire.pair())
                log = on_failure.enter_context(open_log())
            with other_end:
                ours.settimeout(timeout)
                if source is not self.connection:
                    # A race's kernel cannot receive files, so they come in a second message.
                    wire.send(source, wire.FORK)
                wire.send(source, wire.FORK, files=[other_end.fileno(), log.fileno()])
            tag, frames = wire.receive(ours)
            if tag == wire.ERROR:
                with explain_os_errors():
                    raise OSError(json.loads(frames[0])["message"])
            on_failure.pop_all()
        return _ForkedProcess(ours, int(frames[0]), log, self)

    def _drop(self) -> None:
        """Ends the fork server and all its children, even those that are stopped."""
        if self._process.poll() is None:
            os.killpg(self.pid, signal.SIGKILL)
        super()._drop()


@dataclass(eq=False)
class _ForkedProcess(RaceProcess):
    fork_server: ForkServerClient

    def end(self) -> str:
        self.connection.close()
        asked, control = str(self.pid).encode(), self.fork_server.connection
        with contextlib.suppress(EOFError, OSError), self.fork_server.lock:
            wire.send(control, wire.END, asked)
            replied = b""
            while replied != asked:  # a reply to an interrupted request may come first
                _, (replied, status) = wire.receive(control)
            return describe_end(os.waitstatus_to_exitcode(int(status)))
        return "was lost"

    def _drop(self) -> None:
        with contextlib.suppress(OSError):
            wire.send(self.fork_server.connection, wire.DROP, str(self.pid).encode())

    def fork(self) -> RaceProcess:
        return self.fork_server.fork_from(self.connection, self.connection.gettimeout())


#: Fork servers by the process that started them and the folder of their data. A fork of this
#: program starts its own.
_fork_servers: dict[tuple[int, Path], ForkServerClient] = {}
_fork_servers_lock = threading.Lock()


def start_fork_server(root: Path) -> ForkServerClient:
    """Returns this program's fork server for a folder of game data, and starts it if needed.

    This does not wait until the fork server is ready.
    """
    key = os.getpid(), root
    with _fork_servers_lock:
        if key not in _fork_servers:
            with explain_os_errors():
                _fork_servers[key] = ForkServerClient(root)
        return _fork_servers[key]


def _retire(fork_server: ForkServerClient) -> None:
    key = os.getpid(), fork_server.root
    with _fork_servers_lock:
        if _fork_servers.get(key) is fork_server:
            del _fork_servers[key]
    fork_server.release()


@atexit.register
def _close_all() -> None:
    with contextlib.suppress(KeyboardInterrupt):  # remaining fork servers end with the program
        for key in [key for key in _fork_servers if key[0] == os.getpid()]:
            _fork_servers.pop(key).release()
