"""The agent process: loads one agent and replies to observations with actions.

Each message on the socket is a length followed by a message of :mod:`stkzoo.drivers.messages`. The
race's end of the socket is :class:`~stkzoo.drivers.replies.ReplyChannel`. The first message names
the agent's files; each later message contains an observation. The socket is separate from the
agent's standard input and output (``docs/reference/agents.md``).
"""

from __future__ import annotations

import math
import random
import resource
import socket
import sys
from contextlib import ExitStack
from typing import Any

import msgspec
import numpy as np

from stkzoo.drivers import landlock, seccomp
from stkzoo.drivers.code import AgentCode, load_agent
from stkzoo.drivers.failures import printable
from stkzoo.drivers.inline import InlineAgent
from stkzoo.drivers.instances import DriverLimits, DriverRequest
from stkzoo.drivers.messages import (
    MAX_NAME,
    Action,
    Decided,
    ErrorReport,
    Failed,
    LoadRequest,
    Ready,
    Reply,
    decode,
    decode_observation,
    encode,
)
from stkzoo.drivers.replies import LENGTH, length_in
from stkzoo.errors import AgentError
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space

#: Maximum number of threads of all processes of an agent together.
_MAX_THREADS = 512
#: Limits of each process in a sandbox: number of open files, and size of a file [bytes].
_MAX_OPEN_FILES, _MAX_FILE_SIZE = 1024, 64 << 20

_start_decoder = msgspec.msgpack.Decoder(LoadRequest)


class Channel:
    """The agent's end of the socket to the race.

    Args:
        connection: the socket.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._reader = connection, connection.makefile("rb")

    def send(self, message: Reply) -> None:
        """Sends one message.

        Raises:
            OSError: the connection is closed.
        """
        data = encode(message)
        self._connection.sendall(LENGTH.pack(len(data)) + data)

    def receive(self) -> bytes:
        """Waits for one message.

        Raises:
            EOFError: the other end closed the connection.
            OSError: the connection failed.
            ProtocolError: the message is too long.
        """
        return self._exactly(length_in(self._exactly(LENGTH.size)))

    def _exactly(self, size: int) -> bytes:
        data = self._reader.read(size)
        if len(data) < size:
            raise EOFError("the connection was closed")
        return data


def main(connection_fd: int, memory: int) -> None:
    """Runs until the race closes the connection.

    Args:
        connection_fd: file descriptor of the socket to the race.
        memory: memory limit of the process [bytes]; 0 for no limit.
    """
    sys.stdout.reconfigure(line_buffering=True, errors="backslashreplace")  # type: ignore[union-attr]
    connection = socket.socket(fileno=connection_fd)
    connection.set_inheritable(False)
    channel = Channel(connection)
    try:
        start: LoadRequest = decode(_start_decoder, channel.receive())
        _limit(memory, start.cpu_time)
        if start.is_enclosed:
            _enclose(start)
        agent = _load(channel, start)
        while agent is not None:
            channel.send(_decide(agent, decode_observation(channel.receive())))
    except (EOFError, OSError):
        return  # the race is over


def _load(channel: Channel, start: LoadRequest) -> InlineAgent | None:
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
        channel=start.channel,
    )
    agent = InlineAgent(request, load)
    _seed_everything(start.seed)
    try:
        name = agent.ready()
    except AgentError as error:
        channel.send(Failed(ErrorReport.of(error)))
        return None
    _seed_everything(start.seed)
    channel.send(Ready(printable(name, MAX_NAME), agent.paths_used))
    return agent


def _decide(agent: InlineAgent, observation: Any) -> Reply:
    agent.ask(observation)
    try:
        decision = agent.answer()
    except AgentError as error:
        return Failed(ErrorReport.of(error))
    return Decided(Action.of(decision.action), decision.is_clipped)


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
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    if cpu_time is not None:
        most = math.ceil(cpu_time)
        resource.setrlimit(resource.RLIMIT_CPU, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _enclose(start: LoadRequest) -> None:
    """Permanently drops the privileges that the process still has inside its sandbox."""
    # In a user namespace of its own, the process limit counts only this agent's processes.
    if start.has_own_users:
        resource.setrlimit(resource.RLIMIT_NPROC, (_MAX_THREADS, _MAX_THREADS))
    for limit, most in (
        (resource.RLIMIT_NOFILE, _MAX_OPEN_FILES),
        (resource.RLIMIT_FSIZE, _MAX_FILE_SIZE),
        (resource.RLIMIT_MSGQUEUE, 0),
    ):
        resource.setrlimit(limit, (most, most))
    if start.readable:
        landlock.restrict(start.readable, start.writable, start.listable)
    seccomp.restrict(has_own_network=start.has_own_users)
