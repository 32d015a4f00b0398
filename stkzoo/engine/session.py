"""Sessions: each runs one race after another, in separate processes or in this process."""

from __future__ import annotations

import contextlib
import os
import threading
import weakref
from abc import ABC, abstractmethod
from pathlib import Path

import numpy as np
import numpy.typing as npt

from stkzoo._temporary import TemporaryFolder
from stkzoo.engine import wire
from stkzoo.engine.fork_client import start_race_process
from stkzoo.engine.process import (
    NO_COPIES,
    START_TIMEOUT,
    RaceProcess,
    engine_environment,
    explain_os_errors,
    start_remedy,
    tail,
)
from stkzoo.engine.race import GameRace, RaceStart, init_engine
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import Snapshot
from stkzoo.errors import ApiOrderError, EngineCrashed, EngineError, EngineTimeout

Controls = npt.NDArray[np.float32]


class CallTurn:
    """A turn that one thread holds during a call: ``with turn:``.

    The same thread can nest calls, as callbacks and signal handlers do.

    Raises:
        ApiOrderError: another thread has the turn.
    """

    __slots__ = ("_lock",)

    def __init__(self) -> None:
        self._lock = threading.RLock()

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise ApiOrderError(
                "another thread's call runs; wait until it returns, or make an environment for "
                "each thread"
            )

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def __reduce__(self) -> tuple[type[CallTurn], tuple[()]]:
        """Pickles as a new turn, so each copy of an environment has its own turn."""
        return CallTurn, ()


class Session(ABC):
    """Runs races for one environment, one at a time."""

    @property
    def pid(self) -> int | None:
        """Id of the race's own process; ``None`` if there is none."""
        return None

    @abstractmethod
    def start(self, setup: RaceSetup) -> RaceStart:
        """Ends the previous race, starts another and waits until its karts can act.

        Args:
            setup: options of the race.
        """

    def step(self, controls: Controls) -> Snapshot:
        """Calls :meth:`step_async`, then returns the snapshot of :meth:`step_wait`."""
        self.step_async(controls)
        return self.step_wait()

    @abstractmethod
    def step_async(self, controls: Controls) -> None:
        """Requests one step. A separate process simulates it while the caller continues.

        Args:
            controls: ``(P, 7)`` float32, as in :meth:`stkzoo.engine.race.GameRace.step`.

        Raises:
            ApiOrderError: there is no race, or a step is already in progress.
            EngineCrashed: the game's process ended.
        """

    @abstractmethod
    def step_wait(self) -> Snapshot:
        """Waits for the step that :meth:`step_async` requested and returns its snapshot.

        Raises:
            ApiOrderError: no step was requested.
            EngineCrashed: the game's process ended.
            EngineTimeout: the process did not answer in time and was ended.
        """

    def branch(self) -> Session:
        """Returns a new session with a copy of this session's race in its current state.

        Raises:
            EngineError: races cannot be copied here, or the game's process failed.
        """
        raise EngineError(NO_COPIES)

    def resume(self, other: Session) -> None:  # noqa: ARG002 - the interface
        """Ends this session's race and continues with a copy of another session's race.

        Args:
            other: the session whose race is copied in its current state.

        Raises:
            EngineError: as for :meth:`branch`; this session keeps its race.
        """
        raise EngineError(NO_COPIES)

    @abstractmethod
    def close(self) -> None:
        """Ends the race. Repeated calls do nothing; :meth:`start` works afterwards."""


class ProcessSession:
    """The connection to one engine process, with one request at a time.

    Args:
        what: name of the process in error texts.
        remedy: advice in error texts for when the process has ended.
        timeouts: time limit of a request [s], by its tag.

    Attributes:
        what: as above.
        remedy: as above.
    """

    def __init__(self, what: str, remedy: str, timeouts: dict[bytes, float]) -> None:
        self.what, self.remedy = what, remedy
        self._timeouts = timeouts
        self._asked: bytes | None = None  # tag of the request whose reply is outstanding
        self._process: RaceProcess | None = None

    @property
    def pid(self) -> int | None:
        """Process id; ``None`` if no process is running."""
        return self._process.pid if self._process else None

    def close(self) -> None:
        """Ends the process. Repeated calls do nothing; another process can start afterwards."""
        process, self._process, self._asked = self._process, None, None
        if process is not None:
            process.release()

    def __del__(self) -> None:
        with contextlib.suppress(Exception):  # the interpreter may be shutting down
            self.close()

    def _send(self, tag: bytes, *data: bytes) -> None:
        process = self._idle()
        self._asked = tag
        try:
            if process.connection.gettimeout() != self._timeouts[tag]:
                process.connection.settimeout(self._timeouts[tag])
            wire.send(process.connection, tag, *data)
        except BaseException as error:
            self._end_after(error, process)
            raise

    def _receive(self, tag: bytes) -> list[bytes]:
        process = self._living()
        if self._asked != tag:
            raise ApiOrderError("there is no request to wait for")
        try:
            frames = process.reply()
        except BaseException as error:
            self._end_after(error, process)
            raise
        if self._process is process:  # otherwise, a signal handler has closed it
            self._asked = None
        return frames

    def _idle(self) -> RaceProcess:
        process = self._living()
        if self._asked is not None:
            raise ApiOrderError("the reply to the request before is still outstanding")
        return process

    def _living(self) -> RaceProcess:
        if self._process is None:
            raise ApiOrderError(f"{self.what} has ended or was not started; {self.remedy}")
        if self._process.owner != os.getpid():
            raise ApiOrderError(
                f"this race belongs to process {self._process.owner}, from which this process "
                f"({os.getpid()}) was forked; call reset() to start one here"
            )
        return self._process

    def _end_after(self, error: BaseException, process: RaceProcess) -> None:
        """Ends the process after a failure, because its replies no longer match the requests.

        Raises:
            ApiOrderError: :meth:`close` was called during the request.
            EngineCrashed: the process had ended.
            EngineTimeout: no reply came in time.
        """
        if self._process is not process:  # closed by a signal handler or another thread
            if isinstance(error, (EOFError, OSError)):
                raise ApiOrderError(
                    f"{self.what} was closed while it worked on a request; {self.remedy}"
                ) from None
            return
        is_start = self._asked == wire.BEGIN
        self._process, self._asked = None, None
        seconds = process.connection.gettimeout()
        how, log = process.end(), tail(process.log)
        process.log.close()
        remedy = start_remedy(log, self.remedy) if is_start else self.remedy
        if isinstance(error, TimeoutError):
            message = (
                f"{self.what} did not answer within {seconds:g} s and was stopped; {self.remedy}"
            )
            raise EngineTimeout(message, log) from None
        if isinstance(error, (EOFError, OSError)):
            raise EngineCrashed(f"{self.what} {how}; {remedy}", log) from None


class WorkerSession(ProcessSession, Session):
    """A session that runs each race in a new process, so its results repeat bit for bit.

    Args:
        root: folder of the game's data.
        timeout: time limit for one step [s].
    """

    def __init__(self, root: Path, timeout: float = 30.0) -> None:
        super().__init__(
            "the game's process",
            "call reset() to start a new one",
            {wire.BEGIN: START_TIMEOUT, wire.ACT: timeout, wire.FORK: timeout},
        )
        self._root = root

    def start(self, setup: RaceSetup) -> RaceStart:
        """See :meth:`Session.start`."""
        self.start_async(setup)
        return self.start_wait()

    def start_async(self, setup: RaceSetup) -> None:
        """Ends the previous race and requests another; :meth:`start_wait` returns its start.

        Args:
            setup: options of the race.
        """
        self.close()
        self._process = start_race_process(self._root)
        self._send(wire.BEGIN, setup.to_json())

    def start_wait(self) -> RaceStart:
        """Waits for the race that :meth:`start_async` requested and returns its start."""
        return RaceStart.from_frames(*self._receive(wire.BEGIN))

    def step_async(self, controls: Controls) -> None:
        """See :meth:`Session.step_async`."""
        self._send(wire.ACT, controls.tobytes())

    def step_wait(self) -> Snapshot:
        """See :meth:`Session.step_wait`."""
        (reply,) = self._receive(wire.ACT)
        return Snapshot(reply)

    def branch(self) -> WorkerSession:
        """See :meth:`Session.branch`."""
        branch = WorkerSession(self._root, self._timeouts[wire.ACT])
        branch._process = self._fork()
        return branch

    def resume(self, other: Session) -> None:
        """See :meth:`Session.resume`."""
        if not isinstance(other, WorkerSession):
            raise EngineError(NO_COPIES)
        process = other._fork()
        self.close()
        self._process = process

    def _fork(self) -> RaceProcess:
        """Returns a clone of the race's process."""
        process = self._idle()
        try:
            process.connection.settimeout(self._timeouts[wire.FORK])
            return process.fork()
        except EngineError:  # requests and replies still match
            raise
        except BaseException as error:
            self._end_after(error, process)
            raise


#: All local sessions of this process. At most one of them can have a race.
_local_sessions: weakref.WeakSet[LocalSession] = weakref.WeakSet()


class LocalSession(Session):
    """A session that runs races in this process, one at a time.

    With bots, only the first race of a process is reproducible, because the engine carries hidden
    random state from one race to the next. If the game crashes, so does this program.

    Args:
        root: folder of the game's data.
    """

    def __init__(self, root: Path) -> None:
        _local_sessions.add(self)
        self._root = root
        self._race: GameRace | None = None
        self._controls: Controls | None = None

    def start(self, setup: RaceSetup) -> RaceStart:
        """See :meth:`Session.start`."""
        self.close()
        if any(session._race is not None for session in _local_sessions):
            raise ApiOrderError(
                "use_subprocess=False runs the game in this process, which can hold one race "
                "at a time, and another environment's race is running; close that "
                "environment first, or leave use_subprocess at True"
            )
        with explain_os_errors():
            _init_here(self._root)
        self._race = GameRace(setup)
        return self._race.begin()

    def step_async(self, controls: Controls) -> None:
        """See :meth:`Session.step_async`. Here, :meth:`step_wait` simulates the step."""
        if self._race is None:
            raise ApiOrderError("there is no race; call reset() first")
        self._controls = controls

    def step_wait(self) -> Snapshot:
        """See :meth:`Session.step_wait`."""
        controls, self._controls = self._controls, None
        if self._race is None or controls is None:
            raise ApiOrderError("there is no request to wait for")
        return self._race.step(controls)

    def close(self) -> None:
        """See :meth:`Session.close`."""
        race, self._race, self._controls = self._race, None, None
        if race is not None:
            race.stop()

    def __del__(self) -> None:
        self.close()


#: Whether :func:`_init_here` has started the engine in this process.
_has_started = False


def _init_here(root: Path) -> None:
    """Starts the engine in this process, with the environment variables of engine processes.

    Later calls do nothing: the engine keeps its home folder until the program ends.
    """
    global _has_started
    if _has_started:
        return
    home = TemporaryFolder("home")
    environment = dict(os.environ)
    os.environ.update(engine_environment(root, str(home.path)))
    try:
        init_engine()
    finally:
        os.environ.clear()
        os.environ.update(environment)
    _has_started = True
