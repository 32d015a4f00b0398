"""The client of the fork server, and the race processes forked through it."""

from __future__ import annotations

import atexit
import contextlib
import itertools
import json
import os
import select
import socket
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from stkzoo._temporary import LockedTemporaryDirectory
from stkzoo.engine import wire
from stkzoo.engine.process import (
    LOST_CONNECTION,
    START_TIMEOUT,
    RaceProcess,
    SpawnedProcess,
    describe_end,
    engine_environment,
    explain_os_errors,
    open_log,
    spawn_interpreter,
    start_remedy,
    stop,
    tail,
)
from stkzoo.errors import EngineCrashed, EngineTimeout


def can_fork() -> bool:
    """Returns whether races are forked from a fork server (Linux) instead of spawned.

    The environment variable ``STKZOO_START_METHOD=spawn`` disables forking.
    """
    return sys.platform == "linux" and os.environ.get("STKZOO_START_METHOD") != "spawn"


def start_race_process(root: Path) -> RaceProcess:
    """Starts a process that can run races.

    Args:
        root: folder of the game's data, :attr:`stkzoo.engine.assets.Assets.root`.

    Raises:
        EngineCrashed: the engine could not start.
        EngineTimeout: the engine took too long to start.
    """
    with explain_os_errors():
        if not can_fork():
            return SpawnedProcess(root, "worker")
        try:
            return start_fork_server(root).fork()
        except EngineCrashed:  # the fork server was killed after its last use
            return start_fork_server(root).fork()


class ForkServerClient:
    """A connection of this program to one fork server.

    Attributes:
        root: folder of the game's data.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._lock = threading.Lock()
        self._has_forked = False
        self._numbers = itertools.count()
        with contextlib.ExitStack() as on_failure:
            self._log = open_log()
            on_failure.callback(self._log.close)
            self._home = LockedTemporaryDirectory("home")
            on_failure.callback(self._home.close)
            self._control, theirs = wire.pair()
            on_failure.callback(self._control.close)
            self._control.settimeout(START_TIMEOUT)
            with theirs:
                self._process = spawn_interpreter(
                    "fork_server",
                    theirs.fileno(),
                    engine_environment(root, str(self._home.path)),
                    self._log,
                    pass_fds=[theirs.fileno()],
                )
            on_failure.pop_all()

    def fork(self) -> RaceProcess:
        """Returns a new child of the fork server that has not run a race yet.

        Raises:
            EngineCrashed: the fork server ended or could not start.
            EngineTimeout: the child or the fork server did not answer in time and was ended.
        """
        if self._control.is_lost:
            _retire(self)
            raise EngineCrashed(f"the connection to the game's fork server {LOST_CONNECTION}")
        name = f"race {next(self._numbers)}"
        try:
            process = self.fork_from(self._control, START_TIMEOUT, name)
        except TimeoutError:
            if self.end_child(name) is not None:  # other races go on
                raise EngineTimeout(
                    f"a new process of the game did not answer within {START_TIMEOUT:.0f} s and "
                    "was ended",
                    tail(self._log),
                ) from None
            _retire(self)
            raise EngineTimeout(
                f"the game's fork server did not answer within {START_TIMEOUT:.0f} s and was "
                "stopped",
                tail(self._log),
            ) from None
        except (EOFError, ConnectionError):
            log = tail(self._log)
            problem = (
                "is gone; `stkzoo doctor` looks for the cause"
                if self._has_forked
                else f"could not start; {start_remedy(log)}"
            )
            _retire(self)
            raise EngineCrashed(f"the game's fork server {problem}", log) from None
        self._has_forked = True
        return process

    def fork_from(
        self, source: wire.EngineConnection, timeout: float | None, name: str = "clone"
    ) -> RaceProcess:
        """Returns a fork of the fork server or of one of its children.

        If this fails, the new process ends by itself.

        Args:
            source: connection to the process to fork.
            timeout: time limit for the fork [s].
            name: name of the new process in :meth:`end_child`; clones have none.

        Raises:
            EngineError: the system cannot start or clone a process now.
            EOFError: the process to fork has ended.
            ConnectionError: as for EOFError.
            TimeoutError: the new process did not answer in time.
        """
        if source.is_lost:
            raise ConnectionError("the descriptor was closed")
        with contextlib.ExitStack() as on_failure:
            with explain_os_errors():
                ours, theirs = map(on_failure.enter_context, wire.pair())
                log = open_log()
                on_failure.callback(log.close)
            with theirs:
                ours.settimeout(timeout)
                if source is not self._control:
                    # A race's kernel cannot receive files, so they come in a second message.
                    wire.send(source, wire.FORK)
                files = [theirs.fileno(), log.fileno()]
                wire.send(source, wire.FORK, name.encode(), files=files)
            try:
                kind, frames = wire.receive(ours)
            except EOFError:
                if _polled(source, 0, 0.0):  # its other end is closed
                    raise
                raise EngineCrashed(
                    "a new process of the game ended before it could answer; it was killed, or "
                    "are too many files open?",
                    tail(log),
                ) from None
            if kind == wire.ERROR:
                with explain_os_errors():
                    raise OSError(json.loads(frames[0])["message"])
            on_failure.pop_all()
        return _ForkedProcess(ours, int(frames[0]), log, self)

    def end_child(self, child: int | str) -> int | None:
        """Ends a child if it is still running.

        Args:
            child: its process id, or the name with which it was forked.

        Returns:
            The wait status of the child; ``None`` if the fork server could not report it.
        """
        if self._control.is_lost:
            return None
        with contextlib.suppress(EOFError, OSError), self._lock:
            asked = str(child).encode()
            wire.send(self._control, wire.END, asked)
            replied = b""
            while replied != asked:  # a reply to an interrupted request may come first
                if not self._wait_for_reply():
                    return None  # the fork server ends the child when it continues
                _, (replied, status) = wire.receive(self._control)
            return int(status) if status else None
        return None

    def _wait_for_reply(self) -> bool:
        """Returns whether the fork server replies; a stopped one (SIGSTOP) does not."""
        end = time.monotonic() + START_TIMEOUT
        while not _polled(self._control, select.POLLIN, 0.05):
            if _is_stopped(self._process.pid) or time.monotonic() > end:
                return False
        return True

    def close(self) -> None:
        """Ends the fork server and all its children."""
        self._control.close()
        try:
            stop(self._process, 2.0)
        finally:
            self._home.close()
            self._log.close()

    def forget(self) -> None:
        """Closes the handles of a fork server that the parent process started."""
        self._control.close()
        self._process.returncode = 0  # not a child of this process, so there is nothing to wait for
        self._home.release()


def _is_stopped(pid: int) -> bool:
    """Returns whether a signal such as SIGSTOP has stopped a process."""
    try:
        status = Path(f"/proc/{pid}/stat").read_bytes()
    except OSError:
        return False
    return status.rpartition(b") ")[2][:1] in (b"T", b"t")


def _polled(connection: socket.socket, events: int, timeout: float) -> bool:
    """Returns whether an event happens, or the other end is closed, within a time limit [s]."""
    poller = select.poll()
    poller.register(connection, events)
    return bool(poller.poll(timeout * 1000))


@dataclass(eq=False)
class _ForkedProcess(RaceProcess):
    fork_server: ForkServerClient

    def end(self) -> str:
        self.connection.close()
        status = self.fork_server.end_child(self.pid)
        return "was lost" if status is None else describe_end(os.waitstatus_to_exitcode(status))

    def drop(self) -> None:
        if not self.fork_server._control.is_lost:
            with contextlib.suppress(OSError):
                wire.send(self.fork_server._control, wire.DROP, str(self.pid).encode())
        self._free()

    def fork(self) -> RaceProcess:
        return self.fork_server.fork_from(self.connection, self.connection.gettimeout())


_fork_servers: dict[Path, ForkServerClient] = {}
_fork_servers_lock = threading.RLock()  # a signal handler may start a race


def start_fork_server(root: Path) -> ForkServerClient:
    """Returns this program's fork server for a folder of game data, and starts it if needed.

    This does not wait until the fork server is ready.
    """
    with _fork_servers_lock:
        if root not in _fork_servers:
            with explain_os_errors():
                started = ForkServerClient(root)
            if _fork_servers.setdefault(root, started) is not started:
                started.close()  # a signal handler has started one meanwhile
        return _fork_servers[root]


def _retire(fork_server: ForkServerClient) -> None:
    with _fork_servers_lock:
        if _fork_servers.get(fork_server.root) is fork_server:
            del _fork_servers[fork_server.root]
    fork_server.close()


@atexit.register
def _close_all() -> None:
    with contextlib.suppress(KeyboardInterrupt):  # remaining fork servers end with the program
        while _fork_servers:
            _fork_servers.popitem()[1].close()


def _forget_all() -> None:
    global _fork_servers_lock
    _fork_servers_lock = threading.RLock()
    while _fork_servers:
        fork_server = _fork_servers.popitem()[1]
        fork_server.forget()
        _forgotten.append(fork_server)


#: Fork servers of the parent process. References prevent their finalizers from running here.
_forgotten: list[ForkServerClient] = []

if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_all)
