"""The client's side of one server."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from stkzoo.errors import ProtocolError, RemoteError
from stkzoo.race.codec import decode, encode
from stkzoo.race.instances import Decision
from stkzoo.race.remote.keys import KeyPair
from stkzoo.race.remote.library import zmq_module
from stkzoo.race.remote.protocol import (
    ACT,
    ACTED,
    ALIVE,
    BYE,
    CLOSE,
    ERROR,
    HELLO,
    OPEN,
    OPENED,
    VERSION,
    WELCOME,
    pack,
    printable,
    take,
    take_version,
    unpack,
)
from stkzoo.race.remote.sockets import client_socket

__all__ = ["Connection", "Failure", "Opened", "Server"]

#: How long goodbye may take after the program has gone on [ms].
_GOODBYE = 500
#: How long messages that came in time may take to read [s].
_READING = 1.0


@dataclass(frozen=True, slots=True)
class Server:
    """Where a server is, and how to know it.

    Attributes:
        address: in ZeroMQ's form.
        key: its public key; ``None`` for no encryption.
    """

    address: str
    key: str | None = None


@dataclass(frozen=True, slots=True)
class Failure:
    """What the server tells of an agent that failed.

    Attributes:
        text: what happened.
        trace: the traceback in the agent's code, or the last lines that it wrote.
        is_timeout: whether it was too slow.
        is_usable: whether it can be asked again.
    """

    text: str
    trace: str
    is_timeout: bool
    is_usable: bool = False


@dataclass(frozen=True, slots=True)
class Opened:
    """What the server tells of an agent that can drive.

    Attributes:
        name: what it calls itself; may be empty.
        paths_used: how many track segments it looks at; ``None`` is all.
    """

    name: str
    paths_used: int | None


class Connection:
    """Sends and receives; belongs to one thread.

    Nothing waits without an end. Once anything is wrong with the server, :attr:`failure` says
    what, and all methods raise :class:`~stkzoo.errors.RemoteError` at once.

    Args:
        context: ZeroMQ's.
        server: the other end.
        keys: the client's own.
    """

    def __init__(self, context: Any, server: Server, keys: KeyPair | None) -> None:
        self._zmq, self.server = zmq_module(), server
        self.failure = ""
        #: What the server said of itself; empty until it has.
        self.welcome: dict[str, Any] = {}
        self._socket = client_socket(context, server.address, keys, server.key)
        self._monitor = self._socket.get_monitor_socket(
            self._zmq.EVENT_DISCONNECTED
            | self._zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
            | self._zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
            | self._zmq.EVENT_HANDSHAKE_FAILED_AUTH
        )
        self._poller = self._zmq.Poller()
        self._poller.register(self._socket, self._zmq.POLLIN)
        self._poller.register(self._monitor, self._zmq.POLLIN)
        self._next_seat = self._step = 0
        self._opening: set[int] = set()
        self._opened: dict[int, Opened | Failure] = {}
        self._observations: list[list[Any]] = []
        self._asked: set[int] = set()
        self._decided: dict[int, Decision | Failure] = {}
        self._seats: set[int] = set()
        self._send(HELLO, pack(protocol=VERSION, stkzoo=version("stkzoo")))

    # ------------------------------------------------------------------ what the group does

    def wait_welcome(self, deadline: float) -> dict[str, Any]:
        """What the server says of itself."""
        self._wait(lambda: bool(self.welcome), deadline, "connect")
        return self.welcome

    def open(self, **fields: Any) -> int:
        """Asks for a seat; returns its number."""
        number = self._next_seat
        self._next_seat += 1
        self._seats.add(number)
        self._opening.add(number)
        self._send(OPEN, pack(protocol=VERSION, seat=number, **fields))
        return number

    def wait_opened(self, seat: int, deadline: float) -> Opened | Failure:
        """What became of a seat that was asked for."""
        self._wait(lambda: seat in self._opened, deadline, "start an agent")
        return self._opened[seat]

    def ask(self, seat: int, observation: Any) -> None:
        """Keeps an observation until all seats have theirs, or for :meth:`flush`."""
        self._require()
        self._decided.pop(seat, None)
        self._observations.append([seat, encode(observation)])
        if len(self._observations) == len(self._seats):
            self.flush()  # the server may begin while others are still asked

    def flush(self) -> None:
        """Sends all observations that were kept, in one message; never raises."""
        if not self._observations or self.failure:
            return
        observations, self._observations = self._observations, []
        self._step += 1
        self._asked = {seat for seat, _ in observations}
        try:
            self._send(ACT, pack(step=self._step, observations=observations))
        except (ProtocolError, RemoteError) as error:
            self._fail(str(error))

    def wait_decision(self, seat: int, deadline: float) -> Decision | Failure:
        """The decision on the seat's last observation."""
        self._wait(lambda: seat in self._decided, deadline, "answer")
        return self._decided.pop(seat)

    def close_seat(self, seat: int) -> None:
        """Gives a seat back; the last one ends the connection."""
        if seat not in self._seats:
            return
        self._seats.discard(seat)
        if not self.failure and self._seats:
            self._send(CLOSE, pack(seats=[seat]))
        if not self._seats:
            self.close()

    def close(self) -> None:
        """Says goodbye and ends; may be called twice."""
        if self._socket.closed:
            return
        if not self.failure:
            self._send(BYE, b"")
            self.failure = self.failure or "the connection was closed"
        self._socket.disable_monitor()
        self._monitor.close(0)
        self._socket.close(_GOODBYE)

    # ------------------------------------------------------------------ the wire

    def _require(self) -> None:
        if self.failure:
            raise RemoteError(self.failure)

    def _send(self, kind: bytes, body: bytes) -> None:
        self._require()
        try:
            self._socket.send_multipart([kind, body], self._zmq.NOBLOCK)
        except self._zmq.ZMQError as error:
            self._fail(f"{self.server.address} does not take our messages: {error}")

    def _wait(self, is_there: Callable[[], bool], deadline: float, what: str) -> None:
        """Receives until something is there.

        What came in time counts, even if it is read late because another server was awaited.
        """
        while not is_there():
            self._require()
            time_left = deadline - time.monotonic()
            events = self._poller.poll(max(0, math.ceil(time_left * 1000)))
            if time_left < -_READING or (time_left <= 0 and not events):
                self._fail(f"{self.server.address} did not {what} in time")
            for socket, _ in events:
                if socket is self._socket:
                    self._receive()
                elif not self._has_mail():
                    self._take_event()

    def _has_mail(self) -> bool:
        """Whether something that the server said before it went is still to be read."""
        return bool(self._socket.getsockopt(self._zmq.EVENTS) & self._zmq.POLLIN)

    def _take_event(self) -> None:
        from zmq.utils.monitor import parse_monitor_message

        event = parse_monitor_message(self._monitor.recv_multipart())["event"]
        if event == self._zmq.EVENT_DISCONNECTED:
            # Before it has said anything it may just not have let us in yet, or be starting.
            if self.welcome:
                self._fail(f"the connection to {self.server.address} was lost")
        else:
            self._fail(
                f"{self.server.address} does not let us in: it expects a key (--secret) that is on "
                "its list, and to be known by its own (--server-key)"
            )

    def _receive(self) -> None:
        frames = self._socket.recv_multipart()
        try:
            self._take(frames)
        except ProtocolError as error:
            self._fail(f"{self.server.address} broke the protocol: {error}")
        except Exception as error:  # noqa: BLE001 - no server may end the race
            self._fail(f"{self.server.address} broke the protocol: {error!r:.200}")

    def _fail(self, text: str) -> None:
        self.failure = self.failure or text
        self._observations = []

    # ------------------------------------------------------------------ what comes in

    def _take(self, frames: list[bytes]) -> None:
        if len(frames) != 2:
            raise ProtocolError(f"{len(frames)} frames came, expected 2")
        kind, body = frames
        if kind == ALIVE:
            return
        fields = unpack(body)
        if kind == ERROR:
            self._fail(f"{self.server.address}: {printable(take(fields, 'text', str))}")
        elif kind == WELCOME:
            self._take_welcome(fields)
        elif kind == OPENED:
            self._take_opened(fields)
        elif kind == ACTED:
            self._take_acted(fields)
        else:
            raise ProtocolError(f"message kind {kind!r:.20} came")

    def _take_welcome(self, fields: dict[str, Any]) -> None:
        take_version(fields)
        for agent in take(fields, "agents", list):
            if type(agent) is not list or [*map(type, agent)] != [str, str, bool]:
                raise ProtocolError(
                    f"an agent {agent!r:.100}, expected its name, its source and whether it sees "
                    "the ground"
                )
        if not fields["agents"]:
            raise ProtocolError("no agents")
        self.welcome = fields

    def _take_opened(self, fields: dict[str, Any]) -> None:
        seat = take(fields, "seat", int)
        if seat not in self._opening:
            raise ProtocolError(f"news of seat {seat}, which was not asked for")
        self._opening.discard(seat)
        if "error" in fields:
            self._opened[seat] = _failure(fields["error"], is_usable=False)
            return
        paths = fields.get("paths_used")
        if paths is not None and (type(paths) is not int or paths < 0):
            raise ProtocolError(f"{paths!r:.50} track segments, expected a number")
        self._opened[seat] = Opened(printable(take(fields, "name", str), 100), paths)

    def _take_acted(self, fields: dict[str, Any]) -> None:
        if take(fields, "step", int) != self._step:
            raise ProtocolError(f"an answer to step {fields['step']}, expected {self._step}")
        for entry in take(fields, "decisions", list):
            match entry:
                case [int(seat), bytes(action), float(seconds)] if 0 <= seconds < 1e9:
                    self._decide(seat, Decision(decode(action), seconds))
                case _:
                    raise ProtocolError(f"a decision {entry!r:.100}")
        for entry in take(fields, "failures", list):
            match entry:
                case [int(seat), error, bool(is_usable)]:
                    self._decide(seat, _failure(error, is_usable))
                case _:
                    raise ProtocolError(f"a failure {entry!r:.100}")
        if self._asked:
            raise ProtocolError(f"no answer for seats {sorted(self._asked)}")

    def _decide(self, seat: int, outcome: Decision | Failure) -> None:
        if seat not in self._asked:
            raise ProtocolError(f"an answer of seat {seat}, which was not asked")
        self._asked.discard(seat)
        self._decided[seat] = outcome


def _failure(error: Any, is_usable: bool) -> Failure:
    match error:
        case [str(kind), str(text), str(trace)]:
            return Failure(printable(text), printable(trace), kind == "timeout", is_usable)
    raise ProtocolError(f"an error {error!r:.100}")
