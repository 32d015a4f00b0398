"""The process of one agent: loads it, and answers observations with actions until told to end.

Messages on the socket are a length and that many bytes of :mod:`stkzoo.race.codec`. The first
says what to load; each later one carries an observation. What the agent itself reads and
writes goes elsewhere (``docs/agents.md``).
"""

from __future__ import annotations

import random
import socket
import struct
import sys
import time
from typing import Any, Protocol

import numpy as np

from stkzoo.mdp.spaces import kart_action_space, kart_observation_space
from stkzoo.race import codec
from stkzoo.race.agents.code import load_agent
from stkzoo.race.agents.failures import agent_trace, in_words
from stkzoo.race.agents.files import AgentPlace
from stkzoo.race.agents.inline import AgentRunner

__all__ = ["Incoming", "main", "receive", "send"]

_LENGTH = struct.Struct("<I")
_MAX_TEXT = 4000


class Incoming(Protocol):
    """Whatever bytes can be received from."""

    def recv(self, size: int, /) -> bytes:
        """At most so many bytes; none if the other end is gone."""
        ...


def send(connection: socket.socket, message: Any) -> None:
    """Sends one message.

    Raises:
        OSError: the other end is gone, or the socket's time-out passed.
        ProtocolError: it is not plain data.
    """
    data = codec.encode(message)
    connection.sendall(_LENGTH.pack(len(data)) + data)


def receive(connection: Incoming) -> Any:
    """Waits for one message.

    Raises:
        EOFError: the other end is gone.
        OSError: the connection broke, or the socket's time-out passed.
        ProtocolError: what came is no message.
    """
    (length,) = _LENGTH.unpack(_exactly(connection, _LENGTH.size))
    if length > codec.LIMITS.max_bytes:
        return codec.decode(bytes(codec.LIMITS.max_bytes + 1))  # says that it is too long
    return codec.decode(_exactly(connection, length))


def main(connection_fd: int, parent: int, memory: int) -> None:
    """Runs until the other end is gone.

    Args:
        connection_fd: descriptor of the socket to the race.
        parent: process id of the race.
        memory: how much the process may use [bytes]; 0 is no limit.
    """
    _die_with(parent)
    connection = socket.socket(fileno=connection_fd)
    connection.set_inheritable(False)
    try:
        order = receive(connection)
        _limit_memory(memory)
        runner = _start(connection, order)
        while runner is not None:
            send(connection, _decide(runner, *receive(connection)))
    except (EOFError, OSError):
        return  # the race is over


def _start(connection: socket.socket, order: dict[str, Any]) -> AgentRunner | None:
    """Loads the agent and tells the race what came of it."""
    try:
        seed: int = order["seed"]
        _seed_everything(seed)
        place = AgentPlace(**order["place"])
        code = load_agent(place, order["adapter"])
        code.scope.__enter__()  # for good: nobody else's modules are here
        spaces = kart_observation_space(sees_ground=order["sees_ground"]), kart_action_space()
        runner = AgentRunner(code, order["agent"], *spaces, seed)
    except Exception as error:  # noqa: BLE001 - it is the race that must hear of it
        send(connection, {"error": _describe(error)})
        return None
    _seed_everything(seed)
    send(connection, {"name": runner.name, "paths_used": runner.paths_used})
    return runner


def _decide(runner: AgentRunner, number: int, observation: Any) -> dict[str, Any]:
    begin = time.perf_counter()
    try:
        action = runner.act(observation)
    except Exception as error:  # noqa: BLE001 - it is the race that must hear of it
        return {"number": number, "error": _describe(error)}
    return {"number": number, "action": action, "seconds": time.perf_counter() - begin}


def _describe(error: Exception) -> list[str]:
    """An exception in words: what it is, and where it came from."""
    return [in_words(error)[:_MAX_TEXT], agent_trace(error)[-_MAX_TEXT:]]


def _seed_everything(seed: int) -> None:
    """Makes an agent that draws from the common random streams repeatable."""
    random.seed(seed)
    np.random.seed(seed % 2**32)
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(seed)


def _limit_memory(limit: int) -> None:
    if limit and sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _die_with(parent: int) -> None:
    """Makes the kernel end this process when the race's ends (Linux)."""
    if sys.platform == "linux":
        from stkzoo.engine import process_clone

        process_clone.die_with(parent)


def _exactly(connection: Incoming, size: int) -> bytes:
    data = bytearray()
    while len(data) < size:
        block = connection.recv(size - len(data))
        if not block:
            raise EOFError("the connection was closed")
        data += block
    return bytes(data)
