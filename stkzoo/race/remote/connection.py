"""The client's end of a connection to one server."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

from stkzoo.drivers.codec import decode, encode
from stkzoo.drivers.failures import printable, reported_error
from stkzoo.drivers.instances import Decision
from stkzoo.drivers.replies import (
    REPLY_LIMITS,
    arrival_time,
    checks_while_waiting,
    end_wait,
    pending_replies,
    receive_pending,
    run_checks,
)
from stkzoo.errors import AgentError, ProtocolError, RemoteError, shortened
from stkzoo.race.remote import protocol
from stkzoo.race.remote.keys import KeyPair
from stkzoo.race.remote.sockets import (
    MAX_UNREAD,
    QUEUE,
    UnreadData,
    client_socket,
    zmq_module,
)

#: Time limit for ZeroMQ to send the last message in the background [ms].
_GOODBYE = 500
#: Grace period after a deadline for reading messages that arrived in time [s].
_READING = 1.0
#: Maximum number of pings after a message to the server: those before and those after it arrives.
_MAX_PINGS = 2 * QUEUE


@dataclass(frozen=True, slots=True)
class Server:
    """A server's address and identity.

    Attributes:
        address: address in ZeroMQ's format.
        key: the server's public key; ``None`` for no encryption.
    """

    address: str
    key: str | None = None


@dataclass(eq=False)
class Failure(Exception):
    """Raised when the server reports a failure of an agent.

    Attributes:
        error: the agent's error, without the agent's id.
        is_usable: whether the agent accepts further observations.
    """

    error: AgentError
    is_usable: bool = False


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
        #: Fields of the server's welcome message; empty until it arrives.
        self.welcome: dict[str, Any] = {}
        self._socket, self._monitor = client_socket(context, server.address, keys, server.key)
        self._next_seat = self._step = self._num_pings = 0
        self._observations: list[list[Any]] = []
        self._starting: set[int] = set()
        self._asked: set[int] = set()
        self._answers: dict[int, tuple[str, int | None] | Decision | Failure] = {}
        self._seats: set[int] = set()
        self._pending = pending_replies()
        self._flushed = time.monotonic()
        self._unread, self._events = UnreadData(), deque[int]()
        checks_while_waiting().add(self._check_unread)
        self._send(protocol.HELLO, protocol=protocol.VERSION, stkzoo=version("stkzoo"))

    # ------------------------------------------------------------------ requests

    def wait_welcome(self, deadline: float) -> dict[str, Any]:
        """Waits for the server's welcome message and returns its fields.

        Args:
            deadline: time limit (:func:`time.monotonic`).
        """
        self._wait(lambda: bool(self.welcome), deadline, "connect")
        return self.welcome

    def open(self, **fields: Any) -> int:
        """Requests the start of a driver and returns the number of its seat."""
        number = self._next_seat
        self._next_seat += 1
        self._seats.add(number)
        self._starting.add(number)
        self._send(protocol.OPEN, protocol=protocol.VERSION, seat=number, **fields)
        return number

    def wait_answer(self, seat: int, deadline: float, what: str) -> Any:
        """Waits for the reply to the last request of a seat.

        Args:
            seat: number of the seat.
            deadline: time limit (:func:`time.monotonic`).
            what: description of the request, for errors.

        Returns:
            After :meth:`open`, the driver's name and the number of track segments that it uses
                (``None`` for all); after :meth:`ask`, its decision.

        Raises:
            Failure: the driver failed.
            RemoteError: the server did not reply in time, or the connection failed.
        """
        self._wait(lambda: seat in self._answers, deadline, what)
        answer = self._answers.pop(seat)
        if isinstance(answer, Failure):
            raise answer
        return answer

    def ask(self, seat: int, observation: Any) -> None:
        """Buffers an observation. All are sent when each seat has one, or by :meth:`flush`."""
        self._require()
        self._answers.pop(seat, None)
        self._observations.append([seat, encode(observation)])
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
            self._send(protocol.ACT, step=self._step, observations=observations)
        except (ProtocolError, RemoteError) as error:
            self._fail(str(error))
        receive_pending()

    def close_seat(self, seat: int) -> None:
        """Closes a driver instance. Closing the last one closes the connection."""
        if seat not in self._seats:
            return
        self._seats.discard(seat)
        if not self.failure and self._seats:
            self._send(protocol.CLOSE, seats=[seat])
        if not self._seats:
            self.close()

    def close(self) -> None:
        """Notifies the server and closes the connection; may be called more than once."""
        self._pending.discard(self)
        checks_while_waiting().discard(self._check_unread)
        if self._socket.closed:
            return
        if not self.failure:
            self._send(protocol.BYE)
            self.failure = self.failure or "the connection was closed"
        self._socket.disable_monitor()
        self._monitor.close(0)
        self._socket.close(_GOODBYE)

    # ------------------------------------------------------------------ sockets

    def _require(self) -> None:
        if self.failure:
            raise RemoteError(self.failure)

    def _send(self, kind: bytes, **fields: Any) -> None:
        self._require()
        body = protocol.pack(**fields) if fields else b""
        self._num_pings = 0
        try:
            self._socket.send_multipart([kind, body], self._zmq.NOBLOCK)
        except self._zmq.ZMQError as error:
            self._fail(f"{self.server.address} does not accept messages: {error}")

    def _wait(self, is_there: Callable[[], bool], deadline: float, what: str) -> None:
        """Receives messages until a condition holds.

        A message that arrived in time is accepted even if the program reads it late because it
        waited for another server.
        """
        if not is_there():
            receive_pending()
        while not is_there():
            self._require()
            time_left = deadline - time.monotonic()
            events = self._poll(time_left)
            self._require()
            if time_left < -_READING or (time_left <= 0 and not events):
                remedy = (
                    "; start it, or check its address and the keys" if what == "connect" else ""
                )
                self._fail(f"{self.server.address} did not {what} in time{remedy}")
            if (self._socket, self._zmq.POLLIN) in events:
                self._receive()
            self._read_events()
            if self._events and not self._has_mail():
                self._handle_event(self._events.popleft())

    def _poll(self, seconds: float) -> list[tuple[Any, int]]:
        """Waits for events of this connection and receives other drivers' replies meanwhile."""
        milliseconds = run_checks(seconds)
        if self._socket.closed:
            return []
        others = {other.fileno(): other for other in self._pending - {self}}
        poller = self._zmq.Poller()
        for source in (self._socket, self._monitor, *others):
            poller.register(source, self._zmq.POLLIN)
        events = list(poller.poll(milliseconds))
        end_wait()
        for source, _ in events:
            if source in others:
                others[source].receive_available()
        return [event for event in events if event[0] not in others]

    def fileno(self) -> int:
        """Returns the file descriptor that becomes readable when a message may have arrived."""
        return int(self._socket.getsockopt(self._zmq.FD))

    def receive_available(self) -> None:
        """Receives the available messages without waiting; never raises."""
        while not self.failure and self._has_mail():
            self._receive()
        if self.failure:
            self._pending.discard(self)

    def _has_mail(self) -> bool:
        """Returns whether a message is unread, which is possible even after a disconnect."""
        return bool(self._socket.getsockopt(self._zmq.EVENTS) & self._zmq.POLLIN)

    def _read_events(self) -> None:
        """Reads ZeroMQ's events, and keeps those that :meth:`_handle_event` handles."""
        from zmq.utils.monitor import parse_monitor_message

        while self._monitor.poll(0):
            message = parse_monitor_message(self._monitor.recv_multipart())
            if message["event"] == self._zmq.EVENT_CONNECTED:
                self._unread.connected(message["value"])
            else:
                self._events.append(message["event"])

    def _handle_event(self, event: int) -> None:
        if event == self._zmq.EVENT_DISCONNECTED:
            # Before its welcome, the server may still be starting or checking the key.
            if self.welcome:
                self._fail(f"the connection to {self.server.address} was lost")
        else:
            self._fail(
                f"{self.server.address} refuses the connection: it expects a key (--secret) that "
                "is on its list, and its own key (--server-key)"
            )

    def _receive(self) -> None:
        """Receives and handles one message; further frames of an invalid one stay unread."""
        frames = [self._socket.recv()]
        while self._socket.getsockopt(self._zmq.RCVMORE) and len(frames) < 3:
            frames.append(self._socket.recv())
        self._unread.count(frames)
        try:
            self._handle(frames)
        except Exception as error:  # noqa: BLE001 - a server must not end the race
            text = str(error) if isinstance(error, ProtocolError) else shortened(error, 200)
            self._fail(f"{self.server.address} sent an invalid message: {text}")

    def _check_unread(self) -> None:
        """Closes the connection if the server sends a message without end."""
        if self._socket.closed:
            return
        self._read_events()
        if self._unread.is_too_much():
            self._fail(
                f"{self.server.address} sent a message of more than {MAX_UNREAD >> 20} MiB, "
                f"expected at most {protocol.LIMITS.max_bytes >> 20} MiB; use another server"
            )
            self.close()

    def _fail(self, text: str) -> None:
        self.failure = self.failure or text
        self._observations = []
        self._pending.discard(self)

    # ------------------------------------------------------------------ incoming messages

    def _handle(self, frames: list[bytes]) -> None:
        if len(frames) != 2:
            raise ProtocolError(f"received {len(frames)} frames, expected 2")
        kind, body = frames
        if kind == protocol.ALIVE:
            self._handle_ping(body)
            return
        fields = protocol.unpack(body)
        protocol.check_fields(kind, fields)
        if kind == protocol.ERROR:
            text = printable(protocol.field(fields, "text", str), 4000)
            self._fail(f"{self.server.address}: {text}")
        elif kind == protocol.WELCOME:
            self._handle_welcome(fields)
        elif kind == protocol.OPENED:
            self._handle_opened(fields)
        else:
            self._handle_acted(fields)

    def _handle_ping(self, body: bytes) -> None:
        self._num_pings += 1
        if body or self._num_pings > _MAX_PINGS:
            raise ProtocolError(
                f"ping {self._num_pings} of {len(body)} bytes since the last message to it, "
                f"expected at most {_MAX_PINGS} without content"
            )

    def _handle_welcome(self, fields: dict[str, Any]) -> None:
        if self.welcome:
            raise ProtocolError("a second welcome, expected one")
        protocol.check_version(fields)
        agents = protocol.field(fields, "agents", list)
        for agent in agents:
            if type(agent) is not list or [*map(type, agent)] != [str, str, list]:
                raise ProtocolError(
                    f"an agent {shortened(agent, 100)}, expected its name, its source and a list "
                    "of what it observes in addition to the full view"
                )
            protocol.check_extras(agent[2])
        if not agents:
            raise ProtocolError("no agents")
        self.welcome = {
            "agents": [
                [printable(name, 100), printable(source, 100), sorted(set(extras))]
                for name, source, extras in agents
            ]
        }

    def _handle_opened(self, fields: dict[str, Any]) -> None:
        seat = protocol.field(fields, "seat", int)
        if seat not in self._starting:
            raise ProtocolError(f"unexpected start of seat {seat}")
        self._starting.discard(seat)
        if "error" in fields:
            self._answers[seat] = Failure(reported_error(fields["error"], ""))
            return
        paths = fields.get("paths_used")
        if paths is not None and (type(paths) is not int or paths < 0):
            raise ProtocolError(f"{shortened(paths, 50)} track segments, expected a number")
        self._answers[seat] = printable(protocol.field(fields, "name", str), 100), paths

    def _handle_acted(self, fields: dict[str, Any]) -> None:
        """Stores the decisions and failures of a step.

        The server reports the duration of each decision, so that an agent does not pay for a slower
        agent of its server. The part of the time until the reply that the longest of them does not
        explain is added to each decision. At least one agent is thus charged the whole time: a
        server can shift time between its own agents, but cannot hide it.
        """
        if protocol.field(fields, "step", int) != self._step:
            raise ProtocolError(f"an answer to step {fields['step']}, expected {self._step}")
        if not self._asked:
            raise ProtocolError(f"an answer to step {self._step} that was not requested")
        elapsed = max(arrival_time() - self._flushed, 0.0)
        failures = protocol.field(fields, "failures", list)
        for entry in failures:
            match entry:
                case [int(seat), error, bool(is_usable)]:
                    reported = reported_error(error, "")
                    reported.seconds = elapsed
                    self._decide(seat, Failure(reported, is_usable))
                case _:
                    raise ProtocolError(f"a failure {shortened(entry, 100)}")
        decisions = [*map(_decision, protocol.field(fields, "decisions", list))]
        longest = max((decision.seconds for _, decision in decisions), default=0.0)
        unexplained = 0.0 if failures else max(elapsed - longest, 0.0)
        for seat, decision in decisions:
            seconds = min(decision.seconds + unexplained, elapsed)
            self._decide(seat, _decoded(replace(decision, seconds=seconds)))
        if self._asked:
            raise ProtocolError(f"no answer for seats {sorted(self._asked)}")
        self._pending.discard(self)

    def _decide(self, seat: int, outcome: Decision | Failure) -> None:
        if seat not in self._asked:
            raise ProtocolError(f"an answer for seat {seat}, which was not requested")
        self._asked.discard(seat)
        self._answers[seat] = outcome


def _decision(entry: Any) -> tuple[int, Decision]:
    """Reads a seat and its decision: an encoded action and the duration that the server reports.

    Raises:
        ProtocolError: the entry is invalid.
    """
    match entry:
        case [int(seat), bytes(action), float(seconds), bool(is_clipped)] if 0 <= seconds < 1e9:
            return seat, Decision(action, seconds, is_clipped)
    raise ProtocolError(f"a decision {shortened(entry, 100)}")


def _decoded(decision: Decision) -> Decision | Failure:
    """Decodes a decision's action; an agent may send one that is invalid, so only it fails."""
    try:
        return replace(decision, action=decode(decision.action, REPLY_LIMITS))
    except ProtocolError as error:
        return Failure(
            AgentError(f"its action is invalid: {error}", seconds=decision.seconds), True
        )
