"""Agents that run in processes of their own.

An error, an endless loop, a crash or too much memory costs such an agent only its own kart. What
its process can reach is the matter of :mod:`stkzoo.drivers.sandbox`. On Linux, a keeper
(:mod:`stkzoo.drivers.keeper`) starts each agent and ends all that it has started.
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
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, NoReturn

from stkzoo.drivers import keeper
from stkzoo.drivers.failures import OutputTail, reported_error
from stkzoo.drivers.files import AgentFiles
from stkzoo.drivers.instances import Decision, DriverRequest, without_unused_paths
from stkzoo.drivers.replies import ReplyChannel
from stkzoo.drivers.sandbox import Enclosure, enclose
from stkzoo.engine.process import ONE_THREAD, describe_end
from stkzoo.errors import AgentError, AgentTimeout, ConfigError, ProtocolError, shortened
from stkzoo.mdp.spaces import extras_of

_CODE = """\
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from stkzoo.drivers.process import main
main(*map(int, sys.argv[2:]))
"""
#: How long an agent without a time limit may take to read its observation [s].
_SEND_TIMEOUT = 60.0
#: Lines of an agent's output that are shown with its exception.
_LINES_BEFORE_ERROR = 5
#: How long an agent may take to end by itself after the race [s] ...
_GRACE = 0.5
#: ... and its keeper to end all that it has started.
_END_TIMEOUT = 5.0
_HAS_KEEPER = sys.platform == "linux"
_MOST_REASON = 200
#: Errors of agents that miss files because of their sandbox.
_OUT_OF_REACH = ("FileNotFoundError", "PermissionError", "OSError: [Errno 30]")
_HINT = " (in its sandbox it has only its own files; --sandbox off runs it without)"


class IsolatedInstance:
    """An agent in a process of its own.

    Args:
        request: the runner's request; its spaces are those of the ``full`` view.
        files: the agent's files.
        adapter: as for :func:`~stkzoo.drivers.code.load_agent`.

    Raises:
        AgentError: the files are not an agent.
    """

    #: Observations may be passed as they came over a network; the agent's process decodes them.
    takes_encoded = True

    def __init__(
        self, request: DriverRequest, files: AgentFiles, adapter: str | None = None
    ) -> None:
        self._agent, self._limits, self._clock = request.agent, request.limits, request.clock
        self._cores = request.cores
        self._limit: float | None = None  # of the decision
        self._number = 0
        self.is_usable = True
        #: How many track segments the agent uses; ``None`` for all. Known when ready.
        self.paths_used: int | None = None
        self._resources = ExitStack()
        try:
            place = files.place(self._resources)
            limits = request.limits
            enclosure = enclose(limits.sandbox, files, place, adapter, self._resources)
            self._is_enclosed = enclosure != Enclosure()
            self._channel, self._life, self._process = self._spawn(enclosure)
        except (ConfigError, OSError) as error:
            self._resources.close()
            raise AgentError(str(error), self._agent) from error
        self._output = OutputTail(self._process.stdout, request.output_label)
        self._resources.callback(self._output.close)
        self._resources.callback(self._end)
        order = {
            "agent": self._agent,
            "place": dataclasses.asdict(place),
            "adapter": adapter,
            "seed": request.seed,
            "extras": sorted(extras_of(request.observation_space)),
            "cpu_time": self._cpu_time(),
            "is_enclosed": self._is_enclosed,
            "has_own_users": bool(enclosure.command),
            "landlock": [*map(list, (enclosure.readable, enclosure.writable, enclosure.listable))],
        }
        try:
            self._send(order, "start", self._limits.start_timeout)
        except AgentError:
            self._resources.close()
            raise

    def ready(self) -> str:
        """Waits until the agent is loaded."""
        reply = self._receive("start")
        name, paths = reply.get("name"), reply.get("paths_used")
        if not isinstance(name, str) or not (paths is None or isinstance(paths, int)):
            self._fail(f"its process answered with {shortened(reply, 200)}; expected its name")
        self.paths_used = paths
        return name[:100]

    def ask(self, observation: Any) -> None:
        """Sends the observation."""
        self._number += 1
        seen = without_unused_paths(observation, self.paths_used)
        self._limit = self._clock.limit(self._limits.action_timeout)
        self._send([self._number, seen], "action", self._limit)

    def answer(self) -> Decision:
        """Waits for the action; ends the process of an agent that is too late."""
        reply = self._receive("action")
        number = reply.get("number")
        if not isinstance(number, int) or number != self._number:
            self._fail(f"its process answered with {shortened(reply, 200)}; expected an action")
        seconds = self._channel.seconds
        return Decision(reply.get("action"), seconds, reply.get("is_clipped") is True)

    def peak_memory(self) -> float | None:
        """Peak memory of the process so far [MB]; ``None`` where the system does not report it."""
        processes = keeper.descendants(self._process.pid)
        peaks = (keeper.memory_of(process, "status", ("VmHWM:",)) for process in processes)
        return max(peaks, default=0) / 2**20 or None

    def close(self) -> None:
        """Ends the process and all that it started, and removes the agent's unpacked files."""
        self.is_usable = False
        self._channel.close()
        self._has_ended(_GRACE)
        self._resources.close()

    # ------------------------------------------------------------------ messages

    def _send(self, message: Any, phase: str, timeout: float | None) -> None:
        """Sends a message; the time limit holds for the answer too."""
        self._channel.deadline = time.monotonic() + (timeout or _SEND_TIMEOUT)
        with self._talking(phase):
            self._channel.send(message)
        if timeout is None:
            self._channel.deadline = None

    def _receive(self, phase: str) -> dict[str, Any]:
        """The next message of the process; raises the error in it."""
        with self._talking(phase):
            reply = self._channel.receive()
            if not isinstance(reply, dict):
                raise ProtocolError(f"{shortened(reply, 200)}, expected a dict")
            if "error" in reply:
                error = self._with_output(reported_error(reply["error"], self._agent))
                is_out_of_reach = self._is_enclosed and str(error).startswith(_OUT_OF_REACH)
                raise type(error)(
                    f"{error}{_HINT * is_out_of_reach}",
                    self._agent,
                    error.trace,
                    self._channel.seconds,
                )
            return reply

    # ------------------------------------------------------------------ failures

    @contextmanager
    def _talking(self, phase: str) -> Iterator[None]:
        """Ends the process if it does not take part."""
        try:
            yield
        except TimeoutError:
            limit = self._limits.start_timeout if phase == "start" else self._limit
            seconds = f"{limit or _SEND_TIMEOUT:g} s"
            self._fail(
                f"its {phase} took longer than {seconds}; its process was ended", AgentTimeout
            )
        except (EOFError, OSError):
            how = "closed its connection"
            if self._has_ended(_GRACE):
                how = self._how_it_ended()
            self._fail(f"its process {how} when the {phase} was due")
        except ProtocolError as problem:
            self._fail(f"its process sent an invalid message: {problem}")

    def _with_output(self, error: AgentError) -> AgentError:
        """The error with the last lines that the agent printed before it."""
        self._output.wait()
        if output := self._output.text(_LINES_BEFORE_ERROR):
            error.trace = f"{error.trace.rstrip()}\nlast output:\n{output}".lstrip()
        return error

    def _fail(self, message: str, kind: type[AgentError] = AgentError) -> NoReturn:
        seconds = self._channel.seconds
        self._end()
        raise kind(message, self._agent, self._output.text(), seconds)

    # ------------------------------------------------------------------ the process

    def _spawn(
        self, shell: Enclosure
    ) -> tuple[ReplyChannel, socket.socket, subprocess.Popen[bytes]]:
        if sys.platform == "win32":
            raise ConfigError("agents cannot run in processes of their own here; use --inline")
        ours, theirs = socket.socketpair()
        self._resources.callback(ours.close)
        life, end = socket.socketpair()
        self._resources.callback(life.close)
        memory = (self._limits.memory or 0) << 20
        path = json.dumps([path or os.getcwd() for path in sys.path])
        with theirs, end:
            code = [sys.executable, "-c", _CODE, path, str(theirs.fileno()), str(memory)]
            command = [*shell.command, *code]
            if _HAS_KEEPER:
                arguments = map(str, (os.getpid(), theirs.fileno(), memory))
                cores = ",".join(map(str, self._cores))
                command = [sys.executable, "-I", "-S", keeper.__file__, *arguments, cores, *command]
            process = subprocess.Popen(  # noqa: S603 - our own interpreter on our own code
                command,
                stdin=end.fileno() if _HAS_KEEPER else subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
                env={**shell.environment, **ONE_THREAD, "PYTHONHASHSEED": "0"},
            )
        return ReplyChannel(ours), life, process

    def _cpu_time(self) -> float | None:
        """Processor time that each process of the agent may use [s]; ``None`` for no limit."""
        budget = self._clock.budget
        return None if budget is None else self._limits.start_timeout + budget

    def _has_ended(self, seconds: float) -> bool:
        """Waits for the process to end by itself; leaves its id reserved for :meth:`_end`."""
        deadline = time.monotonic() + seconds
        state = os.WEXITED | os.WNOWAIT | os.WNOHANG
        with suppress(ChildProcessError):
            while self._process.returncode is None:
                if os.waitid(os.P_PID, self._process.pid, state) is not None:
                    break
                if time.monotonic() > deadline:
                    return False
                time.sleep(0.002)
        return True

    def _how_it_ended(self) -> str:
        """Says how the process ended by itself, or why its keeper ended it."""
        reason = b""
        with suppress(OSError):
            self._life.setblocking(False)
            reason = self._life.recv(_MOST_REASON)
        self._end()
        code = self._process.returncode
        if _HAS_KEEPER and code - 128 in set(signal.Signals):
            code = 128 - code  # of the agent, which its keeper reports so
        return reason.decode(errors="replace") or describe_end(code)

    def _end(self) -> None:
        """Ends the process and all that it has started."""
        self.is_usable = False
        self._channel.close()
        self._life.close()
        if self._process.returncode is None and _HAS_KEEPER:
            with suppress(ProcessLookupError, subprocess.TimeoutExpired):
                os.kill(self._process.pid, signal.SIGCONT)
                self._process.wait(_END_TIMEOUT)
        if self._process.returncode is None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        self._output.close()
