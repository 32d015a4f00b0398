"""Replies from other processes and machines, each received when it arrives.

The agents of a race think at the same time, and the race waits for one after another. Meanwhile
it receives the replies of the others too. So the time from an agent's observation to its reply
is its own, and no agent can spend the time of another.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import threading
import time
from typing import Any, Protocol

from stkzoo.drivers import codec
from stkzoo.errors import ProtocolError

#: What comes before a message: its length.
LENGTH = struct.Struct("<I")
_BLOCK = 65536


class Receiver(Protocol):
    """Something that waits for a reply."""

    def fileno(self) -> int:
        """The descriptor that becomes readable when a part of the reply arrives."""
        ...

    def receive_available(self) -> None:
        """Receives what has arrived, without waiting; never raises."""
        ...


class PendingReplies(threading.local):
    """The receivers in one thread that wait for a reply."""

    def __init__(self) -> None:
        self.receivers: set[Receiver] = set()


_pending = PendingReplies()


def pending_replies() -> set[Receiver]:
    """The receivers of this thread that wait for a reply; each adds and removes itself."""
    return _pending.receivers


def receive_pending() -> None:
    """Receives what has arrived for this thread, so that its time of arrival is known."""
    for receiver in [*_pending.receivers]:
        receiver.receive_available()


class ReplyChannel:
    """The race's end of the socket to an agent: a message out, a reply back.

    Messages are those of :class:`~stkzoo.drivers.process.Channel`. A deadline holds for a whole
    message, however it trickles in.

    Args:
        connection: the socket.

    Attributes:
        deadline: when the next message must be sent or received, as :func:`time.monotonic`;
            ``None`` for no limit.
    """

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        self._connection = connection
        self._buffer = bytearray()
        self._missing = LENGTH.size
        self._problem: Exception | None = None
        self._pending = pending_replies()
        self._sent, self._arrived = time.monotonic(), math.inf
        self.deadline: float | None = None

    @property
    def seconds(self) -> float:
        """Time from the last message to its whole reply, or until now if there is none [s]."""
        return min(self._arrived, time.monotonic()) - self._sent

    def send(self, message: Any) -> None:
        """Sends one message, whose reply is expected from then on.

        Raises:
            OSError: the other end is gone, or the deadline has passed (``TimeoutError``).
            ProtocolError: the message is not plain data.
        """
        data = codec.encode(message)
        self._sent, self._arrived = time.monotonic(), math.inf
        rest = memoryview(LENGTH.pack(len(data)) + data)
        while rest:
            try:
                rest = rest[self._connection.send(rest) :]
            except BlockingIOError:  # noqa: PERF203 - it is rare
                self._wait(select.POLLOUT)
        self._pending.add(self)

    def receive(self) -> Any:
        """Waits for the reply.

        Raises:
            EOFError: the other end is gone.
            OSError: the connection broke, or the deadline has passed (``TimeoutError``).
            ProtocolError: the bytes are not a message.
        """
        if self._missing and self._problem is None:
            self._pending.add(self)
            self.receive_available()
        while self in self._pending:
            self._wait(select.POLLIN)
        if self._problem is not None:
            raise self._problem
        data = bytes(memoryview(self._buffer)[LENGTH.size :])
        self._buffer, self._missing = bytearray(), LENGTH.size
        return codec.decode(data)

    def fileno(self) -> int:
        """The socket's descriptor."""
        return self._connection.fileno()

    def receive_available(self) -> None:
        """Receives what has arrived, without waiting; :meth:`receive` raises what goes wrong."""
        try:
            while self._missing:
                self._receive_part()
        except BlockingIOError:
            return
        except (EOFError, OSError, ProtocolError) as problem:
            self._problem = problem
        self._arrived = time.monotonic()
        self._pending.discard(self)

    def _receive_part(self) -> None:
        block = self._connection.recv(min(self._missing, _BLOCK))
        if not block:
            raise EOFError("the connection was closed")
        self._buffer += block
        self._missing -= len(block)
        if len(self._buffer) == LENGTH.size:
            self._missing = length_in(self._buffer)

    def close(self) -> None:
        """Closes the socket; may be called again."""
        self._pending.discard(self)
        self._connection.close()

    def _wait(self, event: int) -> None:
        """Waits until the socket can be read or written, or a reply of another agent arrives."""
        left = math.inf if self.deadline is None else self.deadline - time.monotonic()
        if left <= 0:
            raise TimeoutError
        poll = select.poll()
        waiting = {receiver.fileno(): receiver for receiver in self._pending}
        for descriptor in waiting:
            poll.register(descriptor, select.POLLIN)
        if event != select.POLLIN:
            poll.register(self._connection, event)
        events = poll.poll(None if left == math.inf else math.ceil(1000 * left))
        for descriptor, _ in events:
            if descriptor in waiting:
                waiting[descriptor].receive_available()


def length_in(header: bytes | bytearray) -> int:
    """The length of the message that follows.

    Raises:
        ProtocolError: it is too long.
    """
    (length,) = LENGTH.unpack(header)
    if length > codec.LIMITS.max_bytes:
        raise ProtocolError(
            f"a message of {length} bytes, expected at most {codec.LIMITS.max_bytes}"
        )
    return int(length)
