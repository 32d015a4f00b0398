"""The process of one agent: loads the agent and answers observations with actions.

Messages on the socket are a length and that many bytes of :mod:`stkzoo.drivers.codec`; the race's
end is :class:`~stkzoo.drivers.replies.ReplyChannel`. The first
message says what to load; each later one has an observation. The agent's own input and output go
elsewhere (``docs/reference/agents.md``).
"""

from __future__ import annotations

import math
import random
import socket
import sys
from contextlib import ExitStack
from typing import Any

import numpy as np

from stkzoo.drivers import codec, landlock, seccomp
from stkzoo.drivers.code import AgentCode, load_agent
from stkzoo.drivers.failures import error_report
from stkzoo.drivers.files import AgentPlace
from stkzoo.drivers.inline import InlineInstance
from stkzoo.drivers.instances import DriverLimits, DriverRequest
from stkzoo.drivers.replies import LENGTH, length_in
from stkzoo.errors import AgentError
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space

#: Most threads of all processes of an agent together.
_MAX_THREADS = 512
#: In a sandbox, most open files of each process, and the size of each file [bytes].
_MAX_OPEN_FILES, _MAX_FILE_SIZE = 1024, 64 << 20


class Channel:
    """The agent's end of the socket to the race.

    Args:
        connection: the socket.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection

    def send(self, message: Any) -> None:
        """Sends one message.

        Raises:
            OSError: the other end is gone.
            ProtocolError: the message is not plain data.
        """
        data = codec.encode(message)
        self._connection.sendall(LENGTH.pack(len(data)) + data)

    def receive(self) -> Any:
        """Waits for one message.

        Raises:
            EOFError: the other end is gone.
            OSError: the connection broke.
            ProtocolError: the bytes are not a message.
        """
        return codec.decode(self._exactly(length_in(self._exactly(LENGTH.size))))

    def _exactly(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            block = self._connection.recv(size - len(data))
            if not block:
                raise EOFError("the connection was closed")
            data += block
        return bytes(data)


def main(connection_fd: int, memory: int) -> None:
    """Runs until the other end is gone.

    Args:
        connection_fd: descriptor of the socket to the race.
        memory: how much memory the process may use [bytes]; 0 for no limit.
    """
    sys.stdout.reconfigure(line_buffering=True, errors="backslashreplace")  # type: ignore[union-attr]
    connection = socket.socket(fileno=connection_fd)
    connection.set_inheritable(False)
    channel = Channel(connection)
    try:
        order = channel.receive()
        _limit(memory, order["cpu_time"])
        if order["is_enclosed"]:
            _enclose(order)
        instance = _start(channel, order)
        while instance is not None:
            number, observation = channel.receive()
            channel.send({"number": number, **_decide(instance, observation)})
    except (EOFError, OSError):
        return  # the race is over


def _start(channel: Channel, order: dict[str, Any]) -> InlineInstance | None:
    """Loads the agent and reports the outcome to the race."""

    def load(_: ExitStack) -> AgentCode:
        code = load_agent(AgentPlace(**order["place"]), order["adapter"])
        code.scope.__enter__()  # for good: no other agent's modules are here
        return code

    spaces = kart_observation_space(extras=order["extras"]), kart_action_space()
    no_limits = DriverLimits(action_timeout=None, start_timeout=math.inf)  # the race has them
    seed: int = order["seed"]
    instance = InlineInstance(DriverRequest(order["agent"], *spaces, seed, no_limits), load)
    _seed_everything(seed)
    try:
        name = instance.ready()
    except AgentError as error:
        channel.send({"error": error_report(error)})
        return None
    _seed_everything(seed)
    channel.send({"name": name, "paths_used": instance.paths_used})
    return instance


def _decide(instance: InlineInstance, observation: Any) -> dict[str, Any]:
    instance.ask(observation)
    try:
        decision = instance.answer()
    except AgentError as error:
        return {"error": error_report(error)}
    return {"action": decision.action, "is_clipped": decision.is_clipped}


def _seed_everything(seed: int) -> None:
    """Seeds the global random generators, for agents that use them."""
    random.seed(seed)
    np.random.seed(seed % 2**32)
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(seed)


def _limit(memory: int, cpu_time: float | None) -> None:
    """Sets the system's limits of this process and all that it starts.

    Args:
        memory: data of each process [bytes]; 0 for no limit.
        cpu_time: processor time of each process [s]; ``None`` for no limit.
    """
    if sys.platform != "win32":
        import resource

        if memory:
            resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
        if cpu_time is not None:
            most = math.ceil(cpu_time)
            resource.setrlimit(resource.RLIMIT_CPU, (most, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _enclose(order: dict[str, Any]) -> None:
    """Gives up what is left to give up in a sandbox, for good."""
    if sys.platform == "win32":
        return
    import resource

    is_alone: bool = order["has_own_users"]  # so that the limit of processes holds for it alone
    if is_alone:
        resource.setrlimit(resource.RLIMIT_NPROC, (_MAX_THREADS, _MAX_THREADS))
    for limit, most in (
        (resource.RLIMIT_NOFILE, _MAX_OPEN_FILES),
        (resource.RLIMIT_FSIZE, _MAX_FILE_SIZE),
        (resource.RLIMIT_MSGQUEUE, 0),
    ):
        resource.setrlimit(limit, (most, most))
    if any(order["landlock"]):
        landlock.restrict(*order["landlock"])
    seccomp.restrict(has_own_network=is_alone)
