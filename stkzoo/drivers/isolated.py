"""Agents that run in separate processes.

An error, an endless loop, a crash or excessive memory use affects only the agent's own kart.
:mod:`stkzoo.drivers.sandbox` restricts what the process can access. On Linux, a keeper
(:mod:`stkzoo.drivers.keeper`) starts each agent and kills all of its descendants.

Each message on the socket between both ends is a length followed by a message of
:mod:`stkzoo.drivers.messages`. The first one names the agent's files; each later message to the
agent contains an observation. The socket is separate from the agent's standard input and output
(``docs/reference/agents.md``).
"""

from __future__ import annotations

import json
import math
import os
import random
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any, NoReturn, TypeVar

import msgspec
import numpy as np

from stkzoo._imports import python_command, search_path
from stkzoo._os import lower_limit
from stkzoo.drivers import keeper, messages
from stkzoo.drivers.code import AgentCode, load_agent
from stkzoo.drivers.failures import OutputTail
from stkzoo.drivers.files import AgentFiles
from stkzoo.drivers.inline import InlineAgent
from stkzoo.drivers.instances import Decision, DriverLimits, DriverRequest
from stkzoo.drivers.replies import ReplyChannel
from stkzoo.drivers.sandbox import Enclosure, enclose
from stkzoo.engine.process import ONE_THREAD, describe_end
from stkzoo.errors import AgentError, AgentTimeout, ConfigError, ProtocolError
from stkzoo.mdp.spaces import extras_of, kart_action_space, kart_observation_space

_Reply = TypeVar("_Reply", bound=messages.Message)
_CODE = """\
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from stkzoo.drivers.isolated import main
main(int(sys.argv[2]))
"""
#: Time limit for an agent without a time limit to read its observation [s].
_SEND_TIMEOUT = 60.0
#: Number of lines of output that are shown with an agent's exception.
_LINES_BEFORE_ERROR = 5
#: Time limit for an agent to exit by itself after the race [s].
_GRACE = 0.5
#: Time limit for the keeper to kill an agent's processes [s].
_END_TIMEOUT = 5.0
_HAS_KEEPER = sys.platform == "linux"
_MOST_REASON = 200
#: Beginnings of errors that the sandbox may have caused.
_OUT_OF_REACH = (
    "FileNotFoundError",
    "PermissionError",
    "OSError: [Errno 30]",
    "OSError: [Errno 38]",
)
_HINT = " (the sandbox shows only the agent's own files, and refuses some system calls)"


class IsolatedAgent:
    """An agent in its own process.

    Args:
        request: the runner's request; its spaces are those of the ``full`` view.
        files: the agent's files.
        adapter: see :func:`~stkzoo.drivers.code.load_agent`.

    Raises:
        AgentError: the files are not an agent, or the process or its sandbox cannot be started.
    """

    #: :meth:`ask` accepts observations that are still encoded; the agent's process decodes them.
    takes_encoded = True

    def __init__(
        self, request: DriverRequest, files: AgentFiles, adapter: str | None = None
    ) -> None:
        self._request, self._agent, self._limits = request, request.agent, request.limits
        self._timeout = 0.0  # of the current phase [s]
        self._memory = (request.limits.memory or 0) << 20  # [bytes]
        self.is_usable = True
        #: Number of track segments that the agent uses; ``None`` for all. Set by :meth:`ready`.
        self.paths_used: int | None = None
        try:
            with ExitStack() as resources:
                self._start(files, adapter, resources)
                self._resources = resources.pop_all()
        except (ConfigError, OSError) as error:
            raise AgentError(str(error), self._agent) from error

    def _start(self, files: AgentFiles, adapter: str | None, resources: ExitStack) -> None:
        request = self._request
        place = files.place(resources)
        enclosure = enclose(self._limits.sandbox, place, adapter, resources)
        self._is_enclosed = enclosure.confinement is not None
        self._spawn(enclosure, resources)
        self._output = OutputTail(self._process.stdout, request.output_label)
        resources.callback(self._end)
        budget = request.clock.budget
        start = messages.LoadRequest(
            agent=self._agent,
            place=place,
            adapter=adapter,
            seed=request.seed,
            memory=self._memory,
            extras=sorted(extras_of(request.observation_space)),
            cpu_time=None if budget is None else self._limits.start_timeout + budget,
            confinement=enclosure.confinement,
        )
        self._send(messages.encode(start), "start", self._limits.start_timeout)

    def ready(self) -> str:
        """Waits until the agent is loaded and returns the name that it declares."""
        reply = self._receive("start", messages.Ready)
        self.paths_used = reply.paths_used
        return reply.name

    def ask(self, observation: Any) -> None:
        """Sends the observation, which may be encoded already."""
        limit = self._request.clock.limit(self._limits.action_timeout)
        if not isinstance(observation, bytes):
            observation = messages.encode_observation(observation, self.paths_used)
        self._send(observation, "action", limit)

    def answer(self) -> Decision:
        """Waits for the decision; if it arrives too late, kills the agent's process."""
        reply = self._receive("action", messages.Decided)
        return reply.decision(self._channel.seconds)

    def peak_memory(self) -> float | None:
        """Returns the largest peak memory of one of the agent's processes so far [MB].

        Returns:
            ``None`` if the system does not report it.
        """
        processes = keeper.descendants(self._process.pid)
        peaks = (keeper.memory_of(process, ("VmHWM:",)) for process in processes)
        return max(peaks, default=0) / 2**20 or None

    def close(self) -> None:
        """Kills the process and its descendants, and removes the agent's unpacked files."""
        self._channel.close()
        try:
            self._has_ended(_GRACE)
        finally:  # Ctrl-C may interrupt the wait
            self._resources.close()

    # ------------------------------------------------------------------ messages

    def _send(self, message: bytes, phase: str, timeout: float | None) -> None:
        """Sends a message. The time limit covers the reply too."""
        self._timeout = timeout or _SEND_TIMEOUT
        self._channel.deadline = time.monotonic() + self._timeout
        with self._talking(phase):
            self._channel.send(message)
        if timeout is None:
            self._channel.deadline = None

    def _receive(self, phase: str, expected: type[_Reply]) -> _Reply:
        """Waits for the process's next message and raises the error that it reports."""
        with self._talking(phase):
            reply = self._channel.receive()
        if isinstance(reply, messages.Failed):
            error = reply.error(self._agent, self._channel.seconds)
            self._output.wait()
            if output := self._output.text(_LINES_BEFORE_ERROR):
                error.trace = f"{error.trace.rstrip()}\nlast output:\n{output}".lstrip()
            if self._is_enclosed and str(error).startswith(_OUT_OF_REACH):
                error.args = (f"{error}{_HINT}", *error.args[1:])
            raise error
        if not isinstance(reply, expected):
            self._fail(f"its process sent another message than {expected.__name__.lower()!r}")
        return reply

    # ------------------------------------------------------------------ failures

    @contextmanager
    def _talking(self, phase: str) -> Iterator[None]:
        """Kills the process and raises an error if communication with it fails."""
        try:
            yield
        except TimeoutError:
            text = f"its {phase} took longer than {self._timeout:g} s; its process was ended"
            self._fail(text, AgentTimeout)
        except (EOFError, OSError):
            how = "closed its connection"
            if self._has_ended(_GRACE):
                how = self._how_it_ended()
            self._fail(f"its process {how} when the {phase} was due")
        except ProtocolError as problem:
            self._fail(f"its process sent an invalid message: {problem}")

    def _fail(self, message: str, error_type: type[AgentError] = AgentError) -> NoReturn:
        seconds = self._channel.seconds
        self._end()
        raise error_type(message, self._agent, self._output.text(), seconds)

    # ------------------------------------------------------------------ the process

    def _spawn(self, shell: Enclosure, resources: ExitStack) -> None:
        ours, other_end = socket.socketpair()
        resources.callback(ours.close)
        self._life, end = socket.socketpair()
        resources.callback(self._life.close)
        path = json.dumps(search_path())
        with other_end, end:
            command = [*shell.command, *python_command(_CODE, path, str(other_end.fileno()))]
            if _HAS_KEEPER:
                arguments = map(str, (os.getpid(), other_end.fileno(), self._memory))
                cores = ",".join(map(str, self._request.cores))
                command = [sys.executable, "-I", "-S", keeper.__file__, *arguments, cores, *command]
            self._process = subprocess.Popen(  # noqa: S603 - our own interpreter on our own code
                command,
                stdin=end.fileno() if _HAS_KEEPER else subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=[other_end.fileno()],
                start_new_session=True,
                env={**shell.environment, **ONE_THREAD, "PYTHONHASHSEED": "0"},
            )
        self._channel = ReplyChannel(ours)

    def _has_ended(self, seconds: float) -> bool:
        """Waits until the process exits by itself, or the keeper reports why it ends it."""
        with suppress(OSError, subprocess.TimeoutExpired):
            if _HAS_KEEPER:
                self._life.settimeout(seconds)
                self._life.recv(1, socket.MSG_PEEK)
            else:
                self._process.wait(seconds)
            return True
        return False

    def _how_it_ended(self) -> str:
        """Describes how the process exited by itself, or why the keeper killed it."""
        reason = b""
        with suppress(OSError):
            self._life.setblocking(False)
            reason = self._life.recv(_MOST_REASON)
        self._end()
        code = self._process.returncode
        if _HAS_KEEPER and code - 128 in set(signal.Signals):
            code = 128 - code  # the keeper reports the agent's signal as 128 + signal
        return reason.decode(errors="replace") or describe_end(code)

    def _end(self) -> None:
        """Kills the process and its descendants."""
        self.is_usable = False
        self._channel.close()
        is_first = self._life.fileno() != -1
        self._life.close()
        if _HAS_KEEPER and self._process.returncode is None:
            with suppress(ProcessLookupError, subprocess.TimeoutExpired):
                os.kill(self._process.pid, signal.SIGCONT)
                self._process.wait(_END_TIMEOUT)
        if is_first and (self._process.returncode is None or not _HAS_KEEPER):
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._output.close()


# ---------------------------------------------------------------------- the agent's process

_start_decoder = msgspec.msgpack.Decoder(messages.LoadRequest)


class Channel:
    """The agent's end of the socket to the race.

    Args:
        descriptor: file descriptor of the socket.
    """

    def __init__(self, descriptor: int) -> None:
        self._connection = Connection(descriptor)

    def send(self, message: messages.Reply) -> None:
        """Sends one message.

        Raises:
            OSError: the connection is closed.
        """
        self._connection.send_bytes(messages.encode(message))

    def receive(self) -> bytes:
        """Waits for one message.

        Raises:
            EOFError: the other end closed the connection.
            OSError: the connection failed, or the message is too long.
        """
        return self._connection.recv_bytes(messages.MAX_BYTES)


def main(connection_fd: int) -> None:
    """Runs until the race closes the connection.

    Args:
        connection_fd: file descriptor of the socket to the race.
    """
    sys.stdout.reconfigure(line_buffering=True, errors="backslashreplace")  # type: ignore[union-attr]
    os.set_inheritable(connection_fd, False)
    channel = Channel(connection_fd)
    try:
        start = messages.decode(_start_decoder, channel.receive())
        _limit(start.memory, start.cpu_time)
        if start.confinement is not None:
            start.confinement.apply()
        agent = _load(channel, start)
        while agent is not None:
            channel.send(_decide(agent, messages.decode_observation(channel.receive())))
    except (EOFError, OSError):
        return  # the race is over


def _load(channel: Channel, start: messages.LoadRequest) -> InlineAgent | None:
    """Loads the agent and reports the outcome to the race."""

    def load(_: ExitStack) -> AgentCode:
        code = load_agent(start.place, start.adapter)
        code.scope.__enter__()  # never left: this process has no other agent's modules
        return code

    no_limits = DriverLimits(action_timeout=None, start_timeout=math.inf)  # the race's task
    request = DriverRequest(
        start.agent,
        kart_observation_space(extras=start.extras),
        kart_action_space(),
        start.seed,
        no_limits,
    )
    agent = InlineAgent(request, load)
    _seed_everything(start.seed)
    reply = messages.start_reply(agent)
    _seed_everything(start.seed)
    channel.send(reply)
    return agent if isinstance(reply, messages.Ready) else None


def _decide(agent: InlineAgent, observation: Any) -> messages.Reply:
    agent.ask(observation)
    try:
        return messages.Decided.of(agent.answer())
    except AgentError as error:
        return messages.Failed.of(error, is_usable=True)


def _seed_everything(seed: int) -> None:
    """Seeds the global random generators, for agents that use them."""
    random.seed(seed)
    np.random.seed(seed % 2**32)
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(seed)


def _limit(memory: int, cpu_time: float | None) -> None:
    """Sets resource limits for this process and its descendants.

    Args:
        memory: limit of each process's data segment [bytes]; 0 for no limit.
        cpu_time: limit of each process's CPU time [s]; ``None`` for no limit.
    """
    if memory:
        lower_limit(resource.RLIMIT_DATA, memory)
    if cpu_time is not None:
        lower_limit(resource.RLIMIT_CPU, math.ceil(cpu_time))
    lower_limit(resource.RLIMIT_CORE, 0)
