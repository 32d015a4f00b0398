"""The processes that hold the game, seen from the program that uses them.

A race runs in a :class:`RaceProcess`. :func:`start_race_process` makes one: a fork of
this program's fork server (:mod:`stkzoo.engine.fork_server`) where that exists, else a fresh
interpreter. Both speak :mod:`stkzoo.engine.wire`.
"""

from __future__ import annotations

import atexit
import contextlib
import hmac
import json
import os
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

from stkzoo._os import LockedTemporaryDirectory
from stkzoo.engine import wire
from stkzoo.engine.fork_server import READY
from stkzoo.errors import ConfigError, EngineCrashed, EngineError, EngineTimeout

__all__ = [
    "DRAWING_START_TIMEOUT",
    "START_TIMEOUT",
    "Log",
    "RaceProcess",
    "can_fork",
    "engine_environment",
    "start_fork_server",
    "start_race_process",
    "start_render_process",
]

#: Seconds that a process may take to start, and a race to stand on its grid.
START_TIMEOUT = 60.0
#: The same for a race that is drawn: without a graphics card, shaders take minutes.
DRAWING_START_TIMEOUT = 300.0
#: A request that still runs after this many seconds ends the engine process from inside.
_SELF_DESTRUCT_SECONDS = 600
_LOG_TAIL_BYTES = 4096
_TOKEN_BYTES = 32

#: Makes ``stkzoo`` a bare package in the engine's interpreter, so that importing the
#: engine's own modules does not import Gymnasium and the rest of the library.
_BOOTSTRAP = """
import sys, types
sys.path[:] = [path for path in sys.path if path]
sys.modules["stkzoo"] = package = types.ModuleType("stkzoo")
package.__path__ = [sys.argv[1]]
from stkzoo.engine.{module} import main
main(*map(int, sys.argv[2:]))
"""


def can_fork() -> bool:
    """Whether races are forked from a fork server here (Linux), not spawned."""
    return sys.platform == "linux" and os.environ.get("STKZOO_START_METHOD") != "spawn"


class Log:
    """A nameless file that an engine process writes its output to."""

    def __init__(self) -> None:
        self._file: IO[bytes] = tempfile.TemporaryFile(prefix="stkzoo-log-")  # noqa: SIM115

    def fileno(self) -> int:
        """The file's descriptor."""
        return self._file.fileno()

    def tail(self) -> str:
        """The last lines written; nothing once the file is closed."""
        if self._file.closed:
            return ""
        start = max(0, os.fstat(self.fileno()).st_size - _LOG_TAIL_BYTES)
        # Not through the file object: the writer shares its position.
        return os.pread(self.fileno(), _LOG_TAIL_BYTES, start).decode(errors="replace").strip()

    def close(self) -> None:
        """Frees the file."""
        self._file.close()


class RaceProcess:
    """A process that serves one connection, and the means to end it.

    Attributes:
        connection: socket that speaks :mod:`stkzoo.engine.wire`.
        pid: its process id.
        log: what it writes.
    """

    def __init__(self, connection: socket.socket, pid: int, log: Log) -> None:
        self.connection = connection
        self.pid = pid
        self.log = log

    def end(self) -> str:
        """Ends the process if it still lives and says how it ended."""
        raise NotImplementedError

    def drop(self) -> None:
        """Ends the process without waiting for it, and frees what belongs to it."""
        raise NotImplementedError

    def let_go(self, owner: int) -> None:
        """:meth:`drop` in the program that started it; forks of that only free their ends.

        Args:
            owner: process id of the program that started it.
        """
        if owner == os.getpid():
            self.drop()
        else:
            self._free()

    def reply(self) -> list[bytes]:
        """Waits for the frames of one answer of the process.

        Raises:
            EngineError: the game refused what it was asked for.
            EOFError: the process is gone.
            TimeoutError: the connection's time-out passed.
        """
        kind, frames = wire.receive(self.connection)
        if kind == wire.ERROR:
            error = json.loads(frames[0])
            if error["type"] == ConfigError.__name__:
                raise ConfigError(error["message"])
            raise EngineError(
                f"the game refused: {error['type']}: {error['message']}\n{error['traceback']}",
                self.log.tail(),
            )
        return frames

    def fork(self) -> RaceProcess:
        """A copy of the process as it is now; call it between two requests.

        Raises:
            EngineError: no copy could be made; the process is as before.
            EOFError: the process is gone.
            TimeoutError: the connection's time-out passed.
        """
        raise EngineError(
            "a race's state can be saved and copied only where races are forked: on Linux, "
            "without a window, and with STKZOO_START_METHOD not set to spawn"
        )

    def _free(self) -> None:
        self.connection.close()
        self.log.close()


def start_race_process(root: Path) -> RaceProcess:
    """Starts a process that can run races.

    Args:
        root: the game's data, as :attr:`stkzoo.engine.assets.Assets.root`.

    Raises:
        EngineCrashed: the engine could not start.
        EngineTimeout: it took too long to start.
    """
    with _told_what_is_missing():
        if not can_fork():
            return _SpawnedRace(root, "worker")
        try:
            return start_fork_server(root).fork()
        except EngineCrashed:  # the fork server was killed since it was last used
            return start_fork_server(root).fork()


def start_render_process(root: Path, graphics: str, variables: Mapping[str, str]) -> RaceProcess:
    """Starts a process that draws another race (:mod:`stkzoo.engine.render_process`).

    Args:
        root: the game's full data.
        graphics: as in :func:`stkzoo.engine.race.init_engine`.
        variables: more of its environment.

    Raises: as :func:`start_race_process`.
    """
    with _told_what_is_missing():
        return _SpawnedRace(root, "render_process", {"STKZOO_GRAPHICS": graphics, **variables})


@contextlib.contextmanager
def _told_what_is_missing() -> Iterator[None]:
    """Tells in words that there is no room for another process."""
    try:
        yield
    except OSError as error:
        raise EngineError(
            f"the game's process cannot be started: {error}; close() what is no longer needed, "
            "or raise the system's limits (ulimit -a shows them, df the room on its disks)"
        ) from error


def engine_environment(root: Path, home: str) -> dict[str, str]:
    """The environment of an engine process.

    The game reads and writes its settings in ``home``, so that a player's own settings
    change nothing and several processes do not meet there.
    """
    private = {
        "SUPERTUXKART_DATADIR": str(root),
        "HOME": home,
        "XDG_CONFIG_HOME": f"{home}/config",
        "XDG_DATA_HOME": f"{home}/data",
        "XDG_CACHE_HOME": f"{home}/cache",
    }
    threads = dict.fromkeys(
        ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
    )
    return {**os.environ, **private, **threads}


def _spawn(
    module: str, arguments: list[int], environment: Mapping[str, str], log: Log, **options: Any
) -> subprocess.Popen[bytes]:
    package = Path(__file__).resolve().parents[1]
    code = _BOOTSTRAP.format(module=module)
    return subprocess.Popen(  # noqa: S603 - our own interpreter on our own code
        [sys.executable, "-c", code, str(package), *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=log.fileno(),
        stderr=log.fileno(),
        env=environment,
        start_new_session=True,  # a Ctrl-C on the terminal is the program's, not the game's
        **options,
    )


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
            self._process = _spawn(
                "fork_server",
                [theirs.fileno(), _SELF_DESTRUCT_SECONDS],
                engine_environment(root, str(self._home.path)),
                self._log,
                pass_fds=[theirs.fileno()],
            )

    def fork(self) -> RaceProcess:
        """A new child that has run no race yet."""
        with contextlib.ExitStack() as on_failure, self._lock:
            ours, theirs = wire.pair()
            log = Log()
            on_failure.callback(ours.close)
            on_failure.callback(log.close)
            with theirs:
                answer = self._ask({"do": "fork"}, [theirs.fileno(), log.fileno()])
            if answer["pid"] is None:
                raise OSError(answer["error"])
            on_failure.pop_all()
        return _ForkedRace(ours, answer["pid"], log, self)

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
        """Lets go of a fork server that belongs to the process this one was forked from."""
        self._control.close()
        self._process.returncode = 0  # not our child: nothing to wait for
        self._home.release()

    def _ask(self, request: Mapping[str, Any], fds: list[int] | None = None) -> Any:
        """Sends a request and waits for its reply; discards replies to interrupted requests."""
        self._number += 1
        form = json.dumps({"number": self._number, **request}).encode()
        try:
            socket.send_fds(self._control, [form], fds or [])
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


class _ForkedRace(RaceProcess):
    def __init__(
        self, connection: socket.socket, pid: int, log: Log, fork_server: ForkServerClient
    ) -> None:
        super().__init__(connection, pid, log)
        self._fork_server = fork_server

    def end(self) -> str:
        self.connection.close()
        status = self._fork_server.end_child(self.pid)
        return "was lost" if status is None else _describe_end(os.waitstatus_to_exitcode(status))

    def drop(self) -> None:
        self._fork_server.drop_child(self.pid)
        self._free()

    def fork(self) -> RaceProcess:
        with contextlib.ExitStack() as on_failure:
            ours, theirs, log = _connection_and_log()
            on_failure.callback(ours.close)
            on_failure.callback(log.close)
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
                message = "a copy of the game's process ended before it could answer"
                raise EngineCrashed(message, log.tail()) from None
            on_failure.pop_all()
        return _ForkedRace(ours, pid, log, self._fork_server)


def _connection_and_log() -> tuple[socket.socket, socket.socket, Log]:
    """What a copy of a process needs: both ends of a connection, and a log."""
    try:
        with contextlib.ExitStack() as on_failure:
            ends = wire.pair()
            for end in ends:
                on_failure.callback(end.close)
            log = Log()
            on_failure.pop_all()
    except OSError as error:
        raise EngineError(
            f"there is no room for a copy of the game's process: {error}; close() some saved "
            "states, or raise the system's limit on open files (ulimit -n)"
        ) from error
    return *ends, log


class _SpawnedRace(RaceProcess):
    """An interpreter of its own, reached over the loopback interface."""

    def __init__(self, root: Path, module: str, variables: Mapping[str, str] | None = None) -> None:
        self._home = LockedTemporaryDirectory("home")
        home = str(self._home.path)
        log = Log()
        token = secrets.token_bytes(_TOKEN_BYTES)
        environment = engine_environment(root, home) | {"STKZOO_TOKEN": token.hex()}
        environment.setdefault("XDG_RUNTIME_DIR", home)  # a window asks for one
        environment |= variables or {}
        with socket.create_server(("127.0.0.1", 0)) as listener:
            listener.settimeout(0.25)
            port = listener.getsockname()[1]
            self._process = _spawn(module, [port, _SELF_DESTRUCT_SECONDS], environment, log)
            try:
                connection = self._accept(listener, token, log)
            except BaseException:
                self._kill()
                log.close()
                raise
        super().__init__(connection, self._process.pid, log)

    def _accept(self, listener: socket.socket, token: bytes, log: Log) -> socket.socket:
        for _ in range(int(START_TIMEOUT / 0.25)):
            try:
                connection, _ = listener.accept()
            except TimeoutError:
                if self._process.poll() is not None:
                    how = _describe_end(self._process.returncode)
                    raise EngineCrashed(
                        f"the game's process {how} at its start", log.tail()
                    ) from None
                continue
            connection.settimeout(5.0)
            with contextlib.suppress(OSError):
                if hmac.compare_digest(connection.recv(_TOKEN_BYTES, socket.MSG_WAITALL), token):
                    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    return connection
            connection.close()
        raise EngineTimeout(f"the game did not start in {START_TIMEOUT:.0f} s", log.tail())

    def end(self) -> str:
        self.connection.close()
        try:
            self._process.wait(0.2)
        except subprocess.TimeoutExpired:
            self._kill()
        self._home.close()
        return _describe_end(self._process.returncode)

    def drop(self) -> None:
        self._kill()
        self._free()

    def _kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._home.close()


def _describe_end(returncode: int) -> str:
    if returncode >= 0:
        return f"exited with code {returncode}"
    try:
        return f"was ended by {signal.Signals(-returncode).name}"
    except ValueError:
        return f"was ended by signal {-returncode}"


_fork_servers: dict[Path, ForkServerClient] = {}
_fork_servers_lock = threading.Lock()


def start_fork_server(root: Path) -> ForkServerClient:
    """This program's fork server for the given game data; does not wait for it."""
    with _fork_servers_lock:
        if root not in _fork_servers:
            with _told_what_is_missing():
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


#: Fork servers of the process this one was forked from, kept so that nothing tidies them up here.
_forgotten: list[ForkServerClient] = []

if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_all)
