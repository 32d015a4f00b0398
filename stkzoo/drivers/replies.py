"""Receives replies from other processes and machines as they arrive.

The agents of a race decide in parallel, and the race waits for their replies one after another.
While it waits for one agent, it also receives the replies of the others. A reply that arrives while
the race is busy counts from the last time at which the race looked for replies. An agent therefore
never pays for other agents or for the race's own work.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Protocol

import msgspec

from stkzoo.drivers.messages import MAX_REPLY, Reply, check_size, decode
from stkzoo.errors import ProtocolError

#: Header of a message: its length [bytes], as in :mod:`multiprocessing.connection`.
LENGTH = struct.Struct("!I")
_BLOCK = 65536

_replies: msgspec.msgpack.Decoder[Reply] = msgspec.msgpack.Decoder(Reply)


class Receiver(Protocol):
    """An object that waits for a reply."""

    def fileno(self) -> int:
        """Returns the file descriptor that becomes readable when part of the reply arrives."""

    def receive_available(self) -> None:
        """Receives the available data without waiting; never raises."""


class PendingReplies(threading.local):
    """The receivers of one thread that wait for a reply.

    Attributes:
        receivers: the receivers; each adds and removes itself.
        looked: when the thread last looked for replies (:func:`time.monotonic`). A reply that it
            receives now arrived at this time or later.
    """

    def __init__(self) -> None:
        self.receivers: set[Receiver] = set()
        self.looked = -math.inf

    def receive(self) -> None:
        """Receives the data that has arrived for this thread since it last looked."""
        now = time.monotonic()
        for receiver in [*self.receivers]:
            receiver.receive_available()
        self.looked = now

    def wait(self, events: Mapping[int, int], deadline: float | None) -> None:
        """Waits until a descriptor is ready, and receives the replies that arrive meanwhile.

        Args:
            events: the events to wait for (:func:`select.poll`), by descriptor, besides those of
                the thread's receivers.
            deadline: time limit (:func:`time.monotonic`); ``None`` for no limit.
        """
        poll = select.poll()
        waiting = {receiver.fileno(): receiver for receiver in self.receivers}
        for descriptor, event in {**dict.fromkeys(waiting, select.POLLIN), **events}.items():
            poll.register(descriptor, event)
        left = None if deadline is None else max(deadline - time.monotonic(), 0.0)
        ready = poll.poll(None if left is None else math.ceil(1000 * left))
        self.looked = time.monotonic()
        for descriptor, _ in ready:
            if descriptor in waiting:
                waiting[descriptor].receive_available()


#: The receivers of the current thread.
pending = PendingReplies()


class ReplyChannel:
    """The race's end of the socket to an agent. It sends a message and receives a reply.

    The message format is that of :class:`~stkzoo.drivers.isolated.Channel`. The deadline applies to
    the whole message, even if it arrives in many small parts.

    Args:
        connection: the socket.

    Attributes:
        deadline: time by which the next message must be sent or received
            (:func:`time.monotonic`); ``None`` for no limit.
    """

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        self._connection = connection
        self._buffer = bytearray()
        self._missing = LENGTH.size
        self._problem: Exception | None = None
        self._pending = pending.receivers
        self._sent = self._complete = time.monotonic()  # begin and end of sending
        self._arrived = math.inf
        self.deadline: float | None = None

    @property
    def seconds(self) -> float:
        """Time from the last message to its complete reply, or until now without a reply [s]."""
        return min(self._arrived, time.monotonic()) - self._sent

    def send(self, message: bytes) -> None:
        """Sends one encoded message and starts to wait for its reply.

        Raises:
            OSError: the connection is closed, or the deadline has passed (``TimeoutError``).
            ProtocolError: a reply is already there.
        """
        self._sent, self._arrived = time.monotonic(), math.inf
        self._check_for_early_reply()
        rest = memoryview(LENGTH.pack(len(message)) + message)
        while rest:
            try:
                rest = rest[self._connection.send(rest) :]
            except BlockingIOError:  # noqa: PERF203 - it is rare
                self._wait({self.fileno(): select.POLLOUT})
        self._complete = time.monotonic()  # on a shared core, the agent may have thought meanwhile
        self._pending.add(self)
        pending.receive()

    def receive(self) -> Reply:
        """Waits for the reply.

        Raises:
            EOFError: the other end closed the connection.
            OSError: the connection failed, or the deadline has passed (``TimeoutError``).
            ProtocolError: the bytes are not a valid message.
        """
        if self in self._pending:
            pending.receive()
        while self in self._pending:
            self._wait({})
        if self._problem is not None:
            raise self._problem
        data = bytes(memoryview(self._buffer)[LENGTH.size :])
        self._buffer, self._missing = bytearray(), LENGTH.size
        return decode(_replies, data)

    def fileno(self) -> int:
        """Returns the socket's file descriptor."""
        return self._connection.fileno()

    def receive_available(self) -> None:
        """Receives the available data without waiting. :meth:`receive` raises its errors."""
        try:
            while self._missing:
                self._receive_part()
        except BlockingIOError:
            return
        except (EOFError, OSError, ProtocolError) as problem:
            self._problem = problem
        self._arrived = max(pending.looked, self._complete)
        self._pending.discard(self)

    def _receive_part(self) -> None:
        block = self._connection.recv(min(self._missing, _BLOCK))
        if not block:
            raise EOFError("the connection was closed")
        self._buffer += block
        self._missing -= len(block)
        if len(self._buffer) == LENGTH.size:
            (self._missing,) = LENGTH.unpack(self._buffer)
            check_size(self._missing, MAX_REPLY)

    def _check_for_early_reply(self) -> None:
        """Rejects a reply that was sent before its request, since its time cannot be measured."""
        with suppress(BlockingIOError):
            if self._connection.recv(1, socket.MSG_PEEK):
                raise ProtocolError(
                    "a reply came before its request; expected one reply to each request"
                )

    def close(self) -> None:
        """Closes the socket; may be called more than once."""
        self._pending.discard(self)
        self._connection.close()

    def _wait(self, events: Mapping[int, int]) -> None:
        """Waits until the socket is ready or another agent's reply arrives.

        Raises:
            TimeoutError: the deadline has passed.
        """
        if self.deadline is not None and time.monotonic() >= self.deadline:
            raise TimeoutError
        pending.wait(events, self.deadline)
