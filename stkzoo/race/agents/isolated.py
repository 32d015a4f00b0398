"""Seats of agents that run in processes of their own.

What such an agent does to itself (an error, an endless loop, a crash, more memory than it
may have) costs its own kart only. It is no prison for somebody who means harm: an agent can
still read and write what the user who runs the race can.
"""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import Any, NoReturn

from stkzoo.errors import AgentError, AgentTimeout, ConfigError, ProtocolError
from stkzoo.mdp.spaces import shows_ground
from stkzoo.race.agents.failures import OutputTail
from stkzoo.race.agents.files import AgentFiles
from stkzoo.race.agents.process import receive, send
from stkzoo.race.codec import Encoded
from stkzoo.race.instances import Decision, DriverInstance, DriverRequest

__all__ = ["IsolatedInstance", "IsolatedOpener"]

_CODE = """\
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from stkzoo.race.agents.process import main
main(*map(int, sys.argv[2:]))
"""
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
#: How long an agent without a limit may take to read its observation [s].
_SEND_TIMEOUT = 60.0
#: How long an agent may take to end by itself after the race [s].
_GRACE = 0.5


@dataclass(frozen=True, slots=True)
class IsolatedOpener:
    """Opens seats of an agent from files in a process of its own.

    Attributes:
        files: the agent's files.
        adapter: as for :func:`~stkzoo.race.agents.code.load_agent`.
    """

    files: AgentFiles
    adapter: str | None = None

    def __call__(self, request: DriverRequest) -> DriverInstance:
        """Opens a seat."""
        return IsolatedInstance(request, self.files, self.adapter)


class IsolatedInstance:
    """An agent in a process of its own.

    The process ends with the thread that opened the seat, so open it in one that lasts.

    Args:
        request: what the runner asks for; its spaces are those of the ``full`` view.
        files: the agent's files.
        adapter: as for :func:`~stkzoo.race.agents.code.load_agent`.

    Raises:
        AgentError: the files are no agent.
    """

    def __init__(
        self, request: DriverRequest, files: AgentFiles, adapter: str | None = None
    ) -> None:
        self._agent, self._limits = request.agent, request.limits
        self._life = ExitStack()
        self._number = 0
        self._paths: int | None = None
        self._deadline: float | None = None
        self.is_usable = True
        try:
            place = files.place(self._life)
            self._connection, self._process = self._spawn()
        except (ConfigError, OSError) as error:
            self._life.close()
            raise AgentError(str(error), self._agent) from error
        self._output = OutputTail(self._process.stdout)
        self._life.callback(self._output.close)
        self._life.callback(self._end)
        self._allow(self._limits.start_timeout)
        order = {
            "agent": self._agent,
            "place": dataclasses.asdict(place),
            "adapter": adapter,
            "seed": request.seed,
            "sees_ground": shows_ground(request.observation_space),
        }
        try:
            self._send(order, "start")
        except AgentError:
            self._life.close()
            raise

    def ready(self) -> str:
        """Waits until the agent is loaded."""
        reply = self._reply("start")
        name, paths = reply.get("name"), reply.get("paths_used")
        if not isinstance(name, str) or not (paths is None or isinstance(paths, int)):
            self._fail(f"its process answered with {reply!r:.200}; expected its name")
        self._paths = paths
        return name[:100]

    #: Observations may be given as they came over a network; the agent's process decodes them.
    takes_encoded = True

    @property
    def paths_used(self) -> int | None:
        """How many track segments the agent looks at; ``None`` is all. Known when ready."""
        return self._paths

    def ask(self, observation: Any) -> None:
        """Sends the observation."""
        self._allow(self._limits.action_timeout)
        self._number += 1
        self._send((self._number, self._seen(observation)), "action")

    def answer(self) -> Decision:
        """Waits for the action; the process of an agent that is too late is ended."""
        reply = self._reply("action")
        seconds = reply.get("seconds")
        if reply.get("number") != self._number or not isinstance(seconds, float):
            self._fail(f"its process answered with {reply!r:.200}; expected an action")
        return Decision(reply.get("action"), seconds)

    def close(self) -> None:
        """Ends the process with all that it started, and removes what was unpacked for it."""
        self.is_usable = False
        self._connection.close()
        self._wait(_GRACE)
        self._life.close()

    # ------------------------------------------------------------------ messages

    def _seen(self, observation: Any) -> Any:
        """The observation without track segments that the agent does not look at."""
        if self._paths is None or isinstance(observation, Encoded):
            return observation
        return {
            key: value[: self._paths] if key.startswith("paths_") else value
            for key, value in observation.items()
        }

    def _allow(self, seconds: float | None) -> None:
        self._deadline = None if seconds is None else time.monotonic() + seconds

    def _send(self, message: Any, what: str) -> None:
        self._connection.settimeout(self._time_left() or _SEND_TIMEOUT)
        try:
            send(self._connection, message)
        except TimeoutError:
            self._too_late(what)
        except OSError:
            self._lost(what)

    def _reply(self, what: str) -> dict[str, Any]:
        """The next message of the process; an error in it is raised.

        A frame that trickles in byte by byte has no more time than one at once.
        """
        self._connection.settimeout(self._time_left())
        try:
            reply = receive(_Hurried(self._connection, self._time_left))
        except TimeoutError:
            self._too_late(what)
        except (EOFError, OSError):
            self._lost(what)
        except ProtocolError as error:
            self._fail(f"its process sent what is no message: {error}")
        if not isinstance(reply, dict):
            self._fail(f"its process answered with {reply!r:.200}; expected a dict")
        if "error" in reply:
            self._refused(reply["error"])
        return reply

    def _time_left(self) -> float | None:
        if self._deadline is None:
            return None
        return max(self._deadline - time.monotonic(), 1e-4)

    # ------------------------------------------------------------------ failures

    def _refused(self, error: Any) -> NoReturn:
        match error:
            case [str(text), str(trace)]:
                raise AgentError(text, self._agent, trace)
        self._fail(f"its process sent an error that is none: {error!r:.200}")

    def _too_late(self, what: str) -> NoReturn:
        limit = self._limits.start_timeout if what == "start" else self._limits.action_timeout
        self._end()
        raise AgentTimeout(
            f"its {what} took longer than {limit or _SEND_TIMEOUT:g} s; its process was ended",
            self._agent,
            self._output.text(),
        )

    def _lost(self, what: str) -> NoReturn:
        """Raises for a process that closed its connection."""
        how = "closed its connection"
        if self._wait(_GRACE):
            self._end()
            how = _end_in_words(self._process.returncode)
        self._fail(f"its process {how} when the {what} was due")

    def _fail(self, message: str) -> NoReturn:
        self._end()
        raise AgentError(message, self._agent, self._output.text())

    # ------------------------------------------------------------------ the process

    def _spawn(self) -> tuple[socket.socket, subprocess.Popen[bytes]]:
        if sys.platform == "win32":
            raise ConfigError("agents cannot have processes of their own here; use --inline")
        ours, theirs = socket.socketpair()
        memory = (self._limits.memory or 0) << 20
        path = json.dumps([path or os.getcwd() for path in sys.path])
        with theirs:
            arguments = theirs.fileno(), os.getpid(), memory
            process = subprocess.Popen(  # noqa: S603 - our own interpreter on our own code
                [sys.executable, "-c", _CODE, path, *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
                env={**os.environ, **dict.fromkeys(_THREADS, "1"), "PYTHONHASHSEED": "0"},
            )
        self._life.callback(ours.close)
        return ours, process

    def _wait(self, seconds: float) -> bool:
        """Waits for the process to end by itself, without taking notice of it yet."""
        deadline = time.monotonic() + seconds
        while self._process.returncode is None:
            state = os.WEXITED | os.WNOWAIT | os.WNOHANG
            with suppress(ChildProcessError):
                if os.waitid(os.P_PID, self._process.pid, state) is None:
                    if time.monotonic() > deadline:
                        return False
                    time.sleep(0.002)
                    continue
            break
        return True

    def _end(self) -> None:
        """Ends the process and all others of its session."""
        self.is_usable = False
        self._connection.close()
        if self._process.returncode is None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        self._output.close()


class _Hurried:
    """A socket's ``recv`` that keeps to a deadline over several calls."""

    def __init__(self, connection: socket.socket, time_left: Any) -> None:
        self._connection, self._time_left = connection, time_left

    def recv(self, size: int) -> bytes:
        """Up to so many bytes."""
        self._connection.settimeout(self._time_left())
        return self._connection.recv(size)


def _end_in_words(code: int) -> str:
    if code < 0:
        return f"was ended by signal {-code} ({signal.Signals(-code).name})"
    return f"ended with exit status {code}"
