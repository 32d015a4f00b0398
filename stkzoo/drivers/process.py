"""The agent process: loads one agent and replies to observations with actions.

Each message on the socket is a length followed by a message of :mod:`stkzoo.drivers.messages`. The
race's end of the socket is :class:`~stkzoo.drivers.replies.ReplyChannel`. The first message names
the agent's files; each later message contains an observation. The socket is separate from the
agent's standard input and output (``docs/reference/agents.md``).
"""

from __future__ import annotations

import math
import os
import random
import resource
import sys
from contextlib import ExitStack
from multiprocessing.connection import Connection
from typing import Any

import msgspec
import numpy as np

from stkzoo.drivers import messages
from stkzoo.drivers.code import AgentCode, load_agent
from stkzoo.drivers.inline import InlineAgent
from stkzoo.drivers.instances import DriverLimits, DriverRequest
from stkzoo.errors import AgentError
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space

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
        start: messages.LoadRequest = messages.decode(_start_decoder, channel.receive())
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
        channel=start.channel,
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
        decision = agent.answer()
    except AgentError as error:
        return messages.Failed.of(error)
    return messages.Decided.of(decision)


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
