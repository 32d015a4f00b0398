"""The client's end of a connection to a server."""

from __future__ import annotations

import select
import time
from collections import deque
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from stkzoo.drivers.failures import printable
from stkzoo.drivers.messages import Message, encode
from stkzoo.drivers.replies import pending
from stkzoo.errors import ProtocolError, RemoteError
from stkzoo.race.remote import protocol
from stkzoo.race.remote.sockets import KeyPair, client_socket, zmq_module

#: Time limit for ZeroMQ to send the last message in the background [ms].
_GOODBYE = 500


@dataclass(frozen=True, slots=True)
class Server:
    """A server's address and identity.

    Attributes:
        address: address in ZeroMQ's format.
        key: the server's public key; ``None`` for no encryption.
    """

    address: str
    key: str | None = None


class ServerTimeout(RemoteError):
    """Raised when a server does not reply in time."""


class Connection:
    """A connection to a server, which gives one reply to each request. Use it in one thread only.

    All waits are bounded. Only :meth:`reply` raises errors of the connection.

    Args:
        context: ZeroMQ context.
        server: the server.
        keys: the client's keys; ``None`` for no encryption.

    Raises:
        RemoteError: a connection to the server's address is impossible.
    """

    def __init__(self, context: Any, server: Server, keys: KeyPair | None) -> None:
        self._zmq, self._address = zmq_module(), server.address
        self._socket, self._monitor = client_socket(context, server.address, keys, server.key)
        self._failure: RemoteError | None = None
        self._expected: deque[tuple[type[Message], ...]] = deque()
        self._replies: deque[Any] = deque()
        self._pending = pending.receivers
        self._sent = self._arrived = time.monotonic()
        self._is_welcome = False
        self.request(protocol.Hello(protocol.VERSION, version("stkzoo")), protocol.Welcome)

    @property
    def seconds(self) -> float:
        """Time from the last request to the last reply [s]."""
        return max(self._arrived - self._sent, 0.0)

    def request(self, message: Message, *expected: type[Message]) -> None:
        """Sends a request and starts to wait for its reply.

        Args:
            message: the request.
            *expected: types of the reply.
        """
        self.receive_available()  # a reply that is already there is an error
        self._sent = time.monotonic()
        self._expected.append(expected)
        self._send(message)
        pending.receive()

    def reply(self, deadline: float, what: str) -> Any:
        """Waits for the next reply.

        A reply that arrived in time is accepted even if the program reads it late because it waited
        for another server.

        Args:
            deadline: time limit (:func:`time.monotonic`).
            what: what the server does in reply, for errors.

        Raises:
            ServerTimeout: the server did not reply in time.
            RemoteError: the connection failed.
        """
        pending.receive()
        self._look()
        while not self._replies:
            if self._failure:
                raise self._failure
            if time.monotonic() >= deadline:
                remedy = "" if self._is_welcome else "; start it, or check its address and the keys"
                self._fail(f"{self._address} did not {what} in time{remedy}", ServerTimeout)
                continue
            descriptors = self._socket.fileno(), self._monitor.fileno()
            pending.wait(dict.fromkeys(descriptors, select.POLLIN), deadline)
            self._look()
        return self._replies.popleft()

    def close(self) -> None:
        """Notifies the server and closes the connection; may be called more than once."""
        self._send(protocol.Bye())
        self._fail("the connection was closed")

    def fileno(self) -> int:
        """Returns the file descriptor that becomes readable when a message may have arrived."""
        return int(self._socket.fileno())

    def receive_available(self) -> None:
        """Receives the available messages without waiting; never raises.

        Messages can be unread even after a disconnect.
        """
        while not self._failure and self._socket.EVENTS & self._zmq.POLLIN:
            self._receive()
        if self._failure or not self._expected:
            self._pending.discard(self)

    def _send(self, message: Message) -> None:
        if self._failure:
            return
        self._pending.add(self)
        try:
            self._socket.send(encode(message), self._zmq.NOBLOCK)
        except (self._zmq.ZMQError, ProtocolError) as error:
            self._look()  # a server that has refused the connection is a better reason
            self._fail(f"{self._address} does not accept messages: {error}")

    def _look(self) -> None:
        """Receives the available messages, then the events of the connection."""
        self.receive_available()
        while not self._failure and self._monitor.EVENTS & self._zmq.POLLIN:
            self._handle_event()

    def _handle_event(self) -> None:
        """Reads an event of ZeroMQ: the connection was lost, or the handshake failed."""
        from zmq.utils.monitor import recv_monitor_message

        if recv_monitor_message(self._monitor)["event"] != self._zmq.EVENT_DISCONNECTED:
            self._fail(
                f"{self._address} refuses the connection: it expects a key (--secret) that "
                "is on its list, and its own key (--server-key)"
            )
        elif self._is_welcome:  # before, the server may still be starting or checking the key
            self._fail(f"the connection to {self._address} was lost")

    def _receive(self) -> None:
        frames = self._socket.recv_multipart()
        try:
            message = protocol.read_reply(frames)
        except ProtocolError as error:
            self._fail(f"{self._address} sent an invalid message: {error}")
            return
        expected = self._expected.popleft() if self._expected else ()
        if isinstance(message, expected):
            self._is_welcome, self._arrived = True, pending.looked
            self._replies.append(message)
        elif isinstance(message, protocol.Refused):
            self._fail(f"{self._address}: {printable(message.reason)}")
        else:
            name = type(message).__name__.lower()
            self._fail(f"{self._address} sent a message {name!r} that was not requested")

    def _fail(self, text: str, error_type: type[RemoteError] = RemoteError) -> None:
        """Closes the connection, so that ZeroMQ does not collect further messages."""
        self._failure = self._failure or error_type(text)
        self._pending.discard(self)
        if not self._socket.closed:
            self._socket.disable_monitor()
            self._monitor.close(0)
            self._socket.close(_GOODBYE)
