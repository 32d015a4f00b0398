"""The processes that hold the game, seen from the program that uses them.

A race runs in a :class:`RaceProcess`: a fork of this program's fork server
(:mod:`stkzoo.engine.fork_client`) where forking works, else a :class:`SpawnedProcess`, a new
interpreter. Both speak :mod:`stkzoo.engine.wire`.
"""

from __future__ import annotations

import contextlib
import errno
import hmac
import json
import os
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stkzoo._os import LockedTemporaryDirectory, OwnDescriptor
from stkzoo.engine import wire
from stkzoo.errors import ConfigError, EngineCrashed, EngineError, EngineTimeout

#: Time limit for a process to start, and for a race to be ready on the grid [s].
START_TIMEOUT = 60.0
#: The same for the render process: without a graphics card, shaders take minutes.
DRAWING_START_TIMEOUT = 300.0
_LOG_TAIL_BYTES = 4096
#: Errors of the system when the folder for temporary files is missing or not writable.
_NO_FOLDER = (errno.ENOENT, errno.EACCES, errno.EROFS)
_TOKEN_BYTES = 32

#: Environment variables with which numerical libraries use one thread.
ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)

#: Makes ``stkzoo`` a bare package in the engine's interpreter, so that importing the
#: engine's own modules does not import Gymnasium and the rest of the library.
_BOOTSTRAP = """
import sys, types
sys.path[:] = [path for path in sys.path if path]
sys.modules["stkzoo"] = package = types.ModuleType("stkzoo")
package.__path__ = [sys.argv[1]]
from stkzoo.engine.{module} import main
main(int(sys.argv[2]))
"""


#: The output of an engine process.
Log = OwnDescriptor


def open_log() -> Log:
    """An unnamed file for the output of an engine process."""
    with tempfile.TemporaryFile(prefix="stkzoo-log-") as file:
        return Log(os.dup(file.fileno()))


def tail(log: Log) -> str:
    """The last lines of an output; empty once the file is closed."""
    if log.is_lost:
        return ""
    start = max(0, os.fstat(log.fileno()).st_size - _LOG_TAIL_BYTES)
    # Not through the file object: the writer shares its position.
    return os.pread(log.fileno(), _LOG_TAIL_BYTES, start).decode(errors="replace").strip()


@dataclass(eq=False)
class RaceProcess:
    """A process that serves one connection.

    Attributes:
        connection: socket that speaks :mod:`stkzoo.engine.wire`.
        pid: its process id.
        log: its output.
        owner: process id of the program that started it.
    """

    connection: wire.EngineConnection
    pid: int
    log: Log
    owner: int = field(default_factory=os.getpid, init=False)

    def end(self) -> str:
        """Ends the process if it still runs and says how it ended."""
        raise NotImplementedError

    def drop(self) -> None:
        """Ends the process without waiting for it, and releases its resources."""
        raise NotImplementedError

    def release(self) -> None:
        """:meth:`drop` in the program that started it; its forks only close the handles."""
        if self.owner == os.getpid():
            if not self.connection.is_lost:
                with contextlib.suppress(OSError):  # wakes a thread that waits for a reply
                    self.connection.shutdown(socket.SHUT_RDWR)
            self.drop()
        else:
            self._free()

    def reply(self) -> list[bytes]:
        """Waits for one reply and returns its frames.

        Raises:
            EngineError: the game refused the request.
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
                tail(self.log),
            )
        return frames

    def fork(self) -> RaceProcess:
        """A clone of the process in its present state; call it between two requests.

        Raises:
            EngineError: no clone could be made; the process is unchanged.
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


#: What an error says when a descriptor of ours was closed.
LOST_CONNECTION = (
    "was lost: this program closed a file descriptor of stkzoo, as os.closerange and daemon "
    "libraries do"
)


@contextlib.contextmanager
def explain_os_errors() -> Iterator[None]:
    """Explains the error of a system that cannot start another process."""
    try:
        yield
    except OSError as error:
        remedy = (
            "close() environments and saved states that are no longer needed, or raise the "
            "system's limits (ulimit -a shows them, df the room on its disks)"
        )
        if error.errno in _NO_FOLDER and error.filename != sys.executable:
            remedy = "set TMPDIR to a folder that exists and is writable"
        raise EngineError(f"no process of the game can be started: {error}; {remedy}") from error


def engine_environment(root: Path, home: str) -> dict[str, str]:
    """The environment of an engine process.

    The game reads and writes its settings in ``home``, so a player's own settings do not
    affect it, and several processes do not share a folder.
    """
    private = {
        "SUPERTUXKART_DATADIR": str(root),
        "HOME": home,
        "XDG_CONFIG_HOME": f"{home}/config",
        "XDG_DATA_HOME": f"{home}/data",
        "XDG_CACHE_HOME": f"{home}/cache",
    }
    return {**os.environ, **private, **ONE_THREAD}


def spawn_interpreter(
    module: str, channel: int, environment: Mapping[str, str], log: Log, **options: Any
) -> subprocess.Popen[bytes]:
    """Starts a new interpreter that runs ``main`` of one of this package's modules.

    Args:
        module: the module's name.
        channel: the argument of ``main``: a descriptor or a port to reach this program.
        environment: the process's environment.
        log: receives its output.
        **options: of :class:`subprocess.Popen`.
    """
    package = Path(__file__).resolve().parents[1]
    code = _BOOTSTRAP.format(module=module)
    return subprocess.Popen(  # noqa: S603 - our own interpreter on our own code
        [sys.executable, "-c", code, str(package), str(channel)],
        stdin=subprocess.DEVNULL,
        stdout=log.fileno(),
        stderr=log.fileno(),
        env=environment,
        start_new_session=True,  # a Ctrl-C on the terminal is the program's, not the game's
        **options,
    )


class SpawnedProcess(RaceProcess):
    """A new interpreter, connected over the loopback interface."""

    def __init__(self, root: Path, module: str, variables: Mapping[str, str] | None = None) -> None:
        self._home = LockedTemporaryDirectory("home")
        home = str(self._home.path)
        log = open_log()
        token = secrets.token_bytes(_TOKEN_BYTES)
        environment = engine_environment(root, home) | {"STKZOO_TOKEN": token.hex()}
        environment.setdefault("XDG_RUNTIME_DIR", home)  # a window asks for one
        environment |= variables or {}
        with socket.create_server(("127.0.0.1", 0)) as listener:
            listener.settimeout(0.25)
            port = listener.getsockname()[1]
            self._process = spawn_interpreter(module, port, environment, log)
            try:
                connection = self._accept(listener, token, log)
            except BaseException:
                self._kill()
                log.close()
                raise
        super().__init__(connection, self._process.pid, log)

    def _accept(self, listener: socket.socket, token: bytes, log: Log) -> wire.EngineConnection:
        for _ in range(int(START_TIMEOUT / 0.25)):
            try:
                connection, _ = listener.accept()
            except TimeoutError:
                if self._process.poll() is not None:
                    how = describe_end(self._process.returncode)
                    raise EngineCrashed(
                        f"the game's process {how} at its start", tail(log)
                    ) from None
                continue
            connection.settimeout(5.0)
            with contextlib.suppress(OSError):
                if hmac.compare_digest(connection.recv(_TOKEN_BYTES, socket.MSG_WAITALL), token):
                    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    return _own(connection)
            connection.close()
        raise EngineTimeout(f"the game did not start in {START_TIMEOUT:.0f} s", tail(log))

    def end(self) -> str:
        """See :meth:`RaceProcess.end`."""
        self.connection.close()
        self._kill(patience=0.2)
        return describe_end(self._process.returncode)

    def drop(self) -> None:
        """See :meth:`RaceProcess.drop`."""
        self._kill()
        self._free()

    def _kill(self, patience: float = 0.0) -> None:
        stop(self._process, patience)
        self._home.close()


def _own(connection: socket.socket) -> wire.EngineConnection:
    timeout = connection.gettimeout()
    own = wire.EngineConnection(connection.detach())
    own.settimeout(timeout)
    return own


def stop(process: subprocess.Popen[bytes], patience: float) -> None:
    """Waits so many seconds for a process to end by itself, then kills it; at Ctrl-C, at once."""
    try:
        process.wait(patience)
    except BaseException as error:
        process.kill()
        process.wait()
        if not isinstance(error, subprocess.TimeoutExpired):
            raise


def describe_end(returncode: int) -> str:
    """Says how a process ended, such as ``"was ended by SIGKILL"``."""
    if returncode >= 0:
        return f"exited with code {returncode}"
    try:
        return f"was ended by {signal.Signals(-returncode).name}"
    except ValueError:
        return f"was ended by signal {-returncode}"
