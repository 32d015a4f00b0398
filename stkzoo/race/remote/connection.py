"""The client's end of a connection to one server."""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import msgspec

from stkzoo.drivers.failures import printable
from stkzoo.drivers.messages import Failed, Message, Ready, encode
from stkzoo.drivers.replies import arrival_time, pending_replies, receive_pending, wait_for
from stkzoo.errors import ProtocolError, RemoteError
from stkzoo.race.remote import protocol
from stkzoo.race.remote.sockets import KeyPair, client_socket, zmq_module

#: Time limit for ZeroMQ to send the last message in the background [ms].
_GOODBYE = 500
#: Maximum number of pings after a message to the server. A server sends 120 in its patience.
_MAX_PINGS = 200


@dataclass(frozen=True, slots=True)
class Server:
    """A server's address and identity.

    Attributes:
        address: address in ZeroMQ's format.
        key: the server's public key; ``None`` for no encryption.
    """

    address: str
    key: str | None = None


class Connection:
    """A connection to a server. Use it in one thread only.

    All waits are bounded. After a problem with the server, :attr:`failure` describes the problem,
    and methods that send or wait raise :class:`~stkzoo.errors.RemoteError` immediately.

    Args:
        context: ZeroMQ context.
        server: the server.
        keys: the client's keys; ``None`` for no encryption.
    """

    def __init__(self, context: Any, server: Server, keys: KeyPair | None) -> None:
        self._zmq, self.server = zmq_module(), server
        self.failure = ""
        #: The server's welcome message, once it has arrived.
        self.welcome: protocol.Welcome | None = None
        self._socket, self._monitor = client_socket(context, server.address, keys, server.key)
        self._next_seat = self._step = self._num_pings = 0
        self._observations: list[tuple[int, bytes]] = []
        self._seats: set[int] = set()
        self._starting: set[int] = set()
        self._asked: set[int] = set()
        self._answers: dict[int, Ready | Failed | protocol.Answer] = {}
        self._pending = pending_replies()
        self._flushed = time.monotonic()
        self._send(protocol.Hello(protocol.VERSION, version("stkzoo")))

    # ------------------------------------------------------------------ requests

    def wait_welcome(self, deadline: float) -> protocol.Welcome:
        """Waits for the server's welcome message.

        Args:
            deadline: time limit (:func:`time.monotonic`).
        """
        self._wait(lambda: self.welcome is not None, deadline, "connect")
        assert self.welcome is not None  # noqa: S101 - it has arrived
        return self.welcome

    def open(self, **fields: Any) -> int:
        """Requests a seat for an agent and returns its number."""
        seat = self._next_seat
        self._next_seat += 1
        self._seats.add(seat)
        self._starting.add(seat)
        self._send(protocol.Open(seat=seat, **fields))
        return seat

    def wait_answer(self, seat: int, deadline: float, what: str) -> Any:
        """Waits for the reply to the last request of a seat.

        Args:
            seat: number of the seat.
            deadline: time limit (:func:`time.monotonic`).
            what: description of the request, for errors.

        Returns:
            After :meth:`open`, the agent's outcome: :class:`Ready` or :class:`Failed`; after
                :meth:`ask`, its answer.

        Raises:
            RemoteError: the server did not reply in time, or the connection failed.
        """
        self._wait(lambda: seat in self._answers, deadline, what)
        return self._answers.pop(seat)

    def ask(self, seat: int, observation: bytes) -> None:
        """Buffers an observation. All are sent when each seat has one, or by :meth:`flush`."""
        self._require()
        self._answers.pop(seat, None)
        self._observations.append((seat, observation))
        if len(self._observations) == len(self._seats):
            self.flush()  # the server begins before the runner has asked the other servers

    def flush(self) -> None:
        """Sends all buffered observations in one message; never raises."""
        self.receive_available()  # a reply to this step that is already there is an error
        if not self._observations or self.failure:
            return
        observations, self._observations = self._observations, []
        self._step += 1
        self._asked = {seat for seat, _ in observations}
        self._flushed = time.monotonic()
        self._pending.add(self)
        try:
            self._send(protocol.Act(self._step, observations))
        except RemoteError as error:
            self._fail(str(error))
        receive_pending()

    def close_seat(self, seat: int) -> None:
        """Releases a seat. Releasing the last one closes the connection."""
        if seat not in self._seats:
            return
        self._seats.discard(seat)
        if not self._seats:
            self.close()
        elif not self.failure:
            self._send(protocol.Close(seat))

    def close(self) -> None:
        """Notifies the server and closes the connection; may be called more than once."""
        if not self.failure:
            self._send(protocol.Bye())
        self._fail("the connection was closed")

    # ------------------------------------------------------------------ sockets

    def _require(self) -> None:
        if self.failure:
            raise RemoteError(self.failure)

    def _send(self, message: Message) -> None:
        self._require()
        self._num_pings = 0
        try:
            self._socket.send(encode(message), self._zmq.NOBLOCK)
        except self._zmq.ZMQError as error:
            self._fail(f"{self.server.address} does not accept messages: {error}")

    def _wait(self, is_there: Callable[[], bool], deadline: float, what: str) -> None:
        """Receives messages until a condition holds.

        A message that arrived in time is accepted even if the program reads it late because it
        waited for another server.
        """
        receive_pending()
        self._look()
        while not is_there():
            self._require()
            if time.monotonic() >= deadline:
                remedy = (
                    "; start it, or check its address and the keys" if what == "connect" else ""
                )
                self._fail(f"{self.server.address} did not {what} in time{remedy}")
                continue
            own = (self._socket.fileno(), self._monitor.fileno())
            wait_for(dict.fromkeys(own, select.POLLIN), deadline)
            self._look()

    def _look(self) -> None:
        """Receives the available messages, then the events of the connection."""
        self.receive_available()
        while not self.failure and self._monitor.EVENTS & self._zmq.POLLIN:
            self._handle_event()

    def fileno(self) -> int:
        """Returns the file descriptor that becomes readable when a message may have arrived."""
        return int(self._socket.fileno())

    def receive_available(self) -> None:
        """Receives the available messages without waiting; never raises.

        Messages can be unread even after a disconnect.
        """
        while not self.failure and self._socket.EVENTS & self._zmq.POLLIN:
            self._receive()
        if self.failure:
            self._pending.discard(self)

    def _handle_event(self) -> None:
        """Reads an event of ZeroMQ: the connection was lost, or the handshake failed."""
        from zmq.utils.monitor import recv_monitor_message

        if recv_monitor_message(self._monitor)["event"] != self._zmq.EVENT_DISCONNECTED:
            self._fail(
                f"{self.server.address} refuses the connection: it expects a key (--secret) that "
                "is on its list, and its own key (--server-key)"
            )
        elif self.welcome:  # before, the server may still be starting or checking the key
            self._fail(f"the connection to {self.server.address} was lost")

    def _receive(self) -> None:
        frames = self._socket.recv_multipart()
        try:
            self._handle(protocol.read_reply(frames))
        except ProtocolError as error:
            self._fail(f"{self.server.address} sent an invalid message: {error}")

    def _fail(self, text: str) -> None:
        """Closes the connection, so that ZeroMQ does not collect further messages."""
        self.failure = self.failure or text
        self._observations = []
        self._pending.discard(self)
        if not self._socket.closed:
            self._socket.disable_monitor()
            self._monitor.close(0)
            self._socket.close(_GOODBYE)

    # ------------------------------------------------------------------ incoming messages

    def _handle(self, message: protocol.ServerMessage) -> None:
        match message:
            case protocol.Alive():
                self._num_pings += 1
                if self._num_pings > _MAX_PINGS:
                    raise ProtocolError(f"more than {_MAX_PINGS} pings since the last message")
            case protocol.Refused(reason):
                self._fail(f"{self.server.address}: {printable(reason)}")
            case protocol.Welcome():
                if self.welcome:
                    raise ProtocolError("a second welcome, expected one")
                self.welcome = message
            case protocol.Opened(seat, outcome):
                self._resolve(self._starting, seat, outcome)
            case protocol.Acted():
                self._handle_acted(message)

    def _handle_acted(self, message: protocol.Acted) -> None:
        """Stores the decisions and failures of a step.

        The server reports the duration of each decision, so that an agent does not pay for a slower
        agent of its server. The part of the time until the reply that the longest of them does not
        explain is added to each decision. At least one agent is thus charged the whole time: a
        server can shift time between its own agents, but cannot hide it.
        """
        if message.step != self._step or not self._asked:
            raise ProtocolError(f"an answer to step {message.step} that was not requested")
        elapsed = max(arrival_time() - self._flushed, 0.0)
        longest = max((_reported(answer, elapsed) for answer in message.answers), default=0.0)
        unexplained = max(elapsed - longest, 0.0)
        for answer in message.answers:
            seconds = min(_reported(answer, elapsed) + unexplained, elapsed)
            charged = msgspec.structs.replace(answer, seconds=seconds)
            self._resolve(self._asked, answer.seat, charged)
        if self._asked:
            raise ProtocolError(f"no answer for seats {sorted(self._asked)}")
        self._pending.discard(self)

    def _resolve(
        self, awaited: set[int], seat: int, answer: Ready | Failed | protocol.Answer
    ) -> None:
        if seat not in awaited:
            raise ProtocolError(f"an answer for seat {seat}, which was not requested")
        awaited.discard(seat)
        self._answers[seat] = answer


def _reported(answer: protocol.Answer, elapsed: float) -> float:
    """Returns the duration of a decision that the server reports; a failure took all the time."""
    return elapsed if isinstance(answer.outcome, Failed) else answer.seconds
