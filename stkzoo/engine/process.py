"""The program's handles of engine processes.

A race runs in a :class:`RaceProcess`. Where forking works, this is a fork of the program's fork
server (:mod:`stkzoo.engine.fork_client`); otherwise it is a :class:`SpawnedProcess`, a new
interpreter. Both exchange :mod:`stkzoo.engine.wire` messages with the program.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import IO

from stkzoo._imports import python_command, search_path
from stkzoo._installation import library_remedy
from stkzoo._temporary import TemporaryFolder
from stkzoo.engine import wire
from stkzoo.errors import ConfigError, EngineError

#: Time limit for a process to start, and for a race to place its karts on the grid [s].
START_TIMEOUT = 60.0
#: The same limit for the render process [s]. Without a graphics card, shaders take minutes.
DRAWING_START_TIMEOUT = 300.0
_LOG_TAIL_BYTES = 4096
#: System errors for a missing or read-only folder of temporary files.
_NO_FOLDER = (errno.ENOENT, errno.EACCES, errno.EROFS)
#: Arguments of ``personality``, from Linux's ``sys/personality.h``.
_ADDR_NO_RANDOMIZE, _CURRENT_PERSONALITY = 0x0040000, 0xFFFFFFFF

#: Error text for races that cannot be saved or copied.
NO_COPIES = (
    "a race's state can be saved and copied only where races are forked: on Linux, with "
    "use_subprocess=True, and with STKZOO_START_METHOD not set to spawn"
)

#: Functions of the C library with the same results in all its versions (``stkzoo/engine/libm.c``),
#: and faster forms of functions of the engine (``shortcuts.c``). Only Linux has the files, and the
#: second only for x86-64.
LIBM, SHORTCUTS = (
    Path(__file__).with_name(name + EXTENSION_SUFFIXES[0]) for name in ("_libm", "_shortcuts")
)
#: The version of the engine to which :data:`SHORTCUTS` belongs.
_ENGINE_VERSION = "0.7.4"

#: Environment variables that limit numerical libraries to one thread.
ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)

#: Makes ``stkzoo`` an empty package in the engine's interpreter. Otherwise, the import of the
#: engine's modules would also import Gymnasium and the rest of the library.
_BOOTSTRAP = """
import json, sys, types
sys.path[:] = json.loads(sys.argv[3])
sys.modules["stkzoo"] = package = types.ModuleType("stkzoo")
package.__path__ = [sys.argv[1]]
from stkzoo.engine.{module} import main
main(int(sys.argv[2]))
"""


def open_log() -> IO[bytes]:
    """Returns a new unnamed file for the output of an engine process."""
    return tempfile.TemporaryFile(prefix="stkzoo-log-", buffering=0)


def tail(log: IO[bytes]) -> str:
    """Returns the last 4,096 bytes of a log as text."""
    start = max(0, os.fstat(log.fileno()).st_size - _LOG_TAIL_BYTES)
    # pread does not move the file position, which the writer shares.
    return os.pread(log.fileno(), _LOG_TAIL_BYTES, start).decode(errors="replace").strip()


@dataclass(eq=False)
class RaceProcess:
    """A process that serves the requests of one connection.

    Attributes:
        connection: socket for :mod:`stkzoo.engine.wire` messages.
        pid: process id.
        log: output of the process.
        owner: process id of the program that started the process.
    """

    connection: socket.socket
    pid: int
    log: IO[bytes]
    owner: int = field(default_factory=os.getpid, init=False)

    def end(self) -> str:
        """Ends the process if it is still running.

        Returns:
            How the process ended, as in :func:`describe_end`.
        """
        raise NotImplementedError

    def release(self) -> None:
        """Ends the process without waiting for it, and closes its handles.

        In a fork of the program that started the process, this only closes the handles.
        """
        if self.owner == os.getpid():
            self._drop()
        self.connection.close()
        self.log.close()

    def _drop(self) -> None:
        raise NotImplementedError

    def reply(self) -> list[bytes]:
        """Waits for one reply and returns its frames.

        Raises:
            ConfigError: the process rejected an argument.
            EngineError: the process reported another error.
            EOFError: the process has ended.
            TimeoutError: no reply came within the connection's timeout.
        """
        tag, frames = wire.receive(self.connection)
        if tag == wire.ERROR:
            error = json.loads(frames[0])
            if error["type"] == ConfigError.__name__:
                raise ConfigError(error["message"])
            raise EngineError(
                f"the game reported an error: {error['type']}: {error['message']}\n"
                f"{error['traceback']}",
                tail(self.log),
            )
        return frames

    def fork(self) -> RaceProcess:
        """Returns a clone of the process in its current state. Call it between two requests.

        Raises:
            EngineError: the process cannot be cloned; it is unchanged.
            EOFError: the process has ended.
            TimeoutError: the clone did not answer within the connection's timeout.
        """
        raise EngineError(NO_COPIES)


#: Remedy in the error text when a process ended while it loaded the game's data.
_REPLACE_DATA = (
    "if this repeats, the game's data may be damaged; replace it: `stkzoo assets install --force`"
)


def start_remedy(output: str, otherwise: str) -> str:
    """Returns the remedy for a process that ended before it could run a race.

    Args:
        output: output of the process.
        otherwise: advice if no library of the system is missing.
    """
    return library_remedy(output) or f"{otherwise}; {_REPLACE_DATA}"


@contextlib.contextmanager
def explain_os_errors() -> Iterator[None]:
    """Converts an OSError during the start of a process to an EngineError with a remedy."""
    try:
        yield
    except OSError as error:
        remedy = (
            "close() environments and saved states that are no longer needed, or raise the "
            "system's limits (ulimit -a shows them, df the room on its disks)"
        )
        if error.errno in _NO_FOLDER and error.filename != sys.executable:
            remedy = "set TMPDIR to a folder that exists, is writable and has room (see ulimit -f)"
        raise EngineError(f"no process of the game can be started: {error}; {remedy}") from error


def engine_environment(root: Path, home: str) -> dict[str, str]:
    """Returns the environment variables of an engine process.

    The game reads and writes its settings in ``home``, so a player's own settings do not
    affect it, and processes do not share a settings folder.

    Args:
        root: folder of the game's data.
        home: home folder of the process.
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
    module: str, channel: socket.socket, environment: Mapping[str, str], log: IO[bytes]
) -> subprocess.Popen[bytes]:
    """Starts a new interpreter that runs ``main`` of one of this package's modules.

    It has this program's search path, which may be the only place of ``pystk2``, except the current
    folder of an interactive session: that may belong to an agent (:func:`python_command`).

    Args:
        module: name of the module.
        channel: connection to this program, whose descriptor is the argument of ``main``.
        environment: environment variables of the process.
        log: file for the output of the process.
    """
    package = Path(__file__).resolve().parents[1]
    code = _BOOTSTRAP.format(module=module)
    path = json.dumps(search_path(has_current=False))
    with _fixed_addresses():
        return subprocess.Popen(  # noqa: S603 - our own interpreter on our own code
            python_command(code, str(package), str(channel.fileno()), path),
            stdin=subprocess.DEVNULL,
            stdout=log.fileno(),
            stderr=log.fileno(),
            env={**environment, **_preloads(environment, module)},
            start_new_session=True,  # Ctrl-C in the terminal must reach only the program
            pass_fds=[channel.fileno()],
        )


def _preloads(environment: Mapping[str, str], module: str) -> dict[str, str]:
    """Returns the environment variables with which a process first loads stkzoo's libraries."""
    if not LIBM.exists():
        return {}
    # The list of libraries can name files, but has no paths with spaces.
    libraries = [environment.get("LD_PRELOAD"), LIBM.name]
    is_known = metadata.version("PySuperTuxKart2") == _ENGINE_VERSION
    if SHORTCUTS.exists() and is_known and module != "render_process":
        libraries.append(SHORTCUTS.name)
    folders = [str(LIBM.parent), environment.get("LD_LIBRARY_PATH")]
    return {
        "LD_PRELOAD": " ".join(filter(None, libraries)),
        "LD_LIBRARY_PATH": ":".join(filter(None, folders)),
    }


@contextlib.contextmanager
def _fixed_addresses() -> Iterator[None]:
    """Starts programs without address randomization, where the system has it and allows that.

    The engine orders some objects by their addresses, so with random addresses a few races have
    several outcomes. Only programs that the calling thread starts are affected.
    """
    if sys.platform != "linux":
        yield
        return
    personality = ctypes.CDLL(None).personality
    before = personality(ctypes.c_ulong(_CURRENT_PERSONALITY))
    personality(ctypes.c_ulong(before | _ADDR_NO_RANDOMIZE))
    try:
        yield
    finally:
        personality(ctypes.c_ulong(before))


class SpawnedProcess(RaceProcess):
    """A new interpreter. It reads its first request after the engine has started.

    Args:
        root: folder of the game's data.
        module: the module whose ``main`` the interpreter runs.
        variables: further environment variables.
    """

    def __init__(self, root: Path, module: str, variables: Mapping[str, str] | None = None) -> None:
        with contextlib.ExitStack() as on_failure:
            self._home = on_failure.enter_context(TemporaryFolder("home"))
            log = on_failure.enter_context(open_log())
            connection, other_end = map(on_failure.enter_context, wire.pair())
            home = str(self._home.path)
            # A window needs XDG_RUNTIME_DIR.
            environment = {"XDG_RUNTIME_DIR": home, **engine_environment(root, home)}
            with other_end:
                environment |= variables or {}
                self._process = spawn_interpreter(module, other_end, environment, log)
            on_failure.pop_all()
        super().__init__(connection, self._process.pid, log)

    def end(self) -> str:
        """See :meth:`RaceProcess.end`."""
        self.connection.close()
        self._kill(patience=0.2)
        return describe_end(self._process.returncode)

    def _drop(self) -> None:
        self._kill(patience=0.0)

    def _kill(self, patience: float) -> None:
        """Waits for the process to end by itself, then kills it. Ctrl-C kills it immediately.

        Args:
            patience: how long to wait [s].
        """
        try:
            self._process.wait(patience)
        except BaseException as error:
            self._process.kill()
            self._process.wait()
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
        finally:
            self._home.close()


def describe_end(returncode: int) -> str:
    """Returns a description of how a process ended, such as ``"was ended by SIGKILL"``.

    Args:
        returncode: as in :class:`subprocess.Popen`.
    """
    if returncode >= 0:
        return f"exited with code {returncode}"
    try:
        return f"was ended by {signal.Signals(-returncode).name}"
    except ValueError:
        return f"was ended by signal {-returncode}"
