"""The server: agents that drive in races that run elsewhere."""

from __future__ import annotations

import contextlib
import itertools
import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from stkzoo.errors import ConfigError, ProtocolError
from stkzoo.race.codec import Limits
from stkzoo.race.drivers import Driver
from stkzoo.race.instances import DriverLimits
from stkzoo.race.remote.library import zmq_module
from stkzoo.race.remote.protocol import (
    ALIVE,
    BYE,
    CLOSE,
    ERROR,
    HELLO,
    OPEN,
    VERSION,
    WELCOME,
    pack,
    take_version,
    unpack,
)
from stkzoo.race.remote.session import Reply, Session
from stkzoo.race.remote.sockets import (
    DEFAULT_ADDRESS,
    ClientAuthenticator,
    ServerKeys,
    full_address,
    server_socket,
)

__all__ = ["RaceServer"]

_log = logging.getLogger(__name__)

#: A client that says nothing is asked whether it is there after this [s], then ever more
#: rarely: a race that is paused reads nothing, and its queue must not fill up.
_ASK = 2.0
#: Seats of a client that has said nothing for so long are given up [s].
_PATIENCE = 600.0
#: How long sessions may take to end when the server closes [s].
_GRACE = 15.0
_HELLO_LIMITS = Limits(max_bytes=4096, max_depth=2, max_length=16)
_NUMBERS = itertools.count()


@dataclass(slots=True)
class _Guest:
    """A client that has a session.

    Attributes:
        session: its seats.
        heard: when it last said something, ``asked``: when it was last told something.
    """

    session: Session
    heard: float
    asked: float

    def is_to_be_asked(self, now: float) -> bool:
        """Whether it is time to see if it is still there."""
        return now - max(self.asked, self.heard) > max(_ASK, (now - self.heard) / 3)


class RaceServer:
    """Serves agents to races elsewhere, race after race, to several clients at once.

    It listens from the start; :meth:`serve` does the work, in the thread that calls it.

    Args:
        drivers: who can be given a seat; none may be the game's own AI.
        address: where to listen (:func:`~stkzoo.race.remote.full_address`).
        limits: what each agent may use at most; a client may ask for less time.
        max_sessions: clients served at once; others are told to come back later.
        keys: who the server is and whom it serves.
        insecure: listen beyond this machine even without keys.

    Raises:
        ConfigError: an argument cannot be, the address cannot be listened on, or pyzmq is
            not installed.
    """

    def __init__(
        self,
        drivers: Sequence[Driver],
        address: str = DEFAULT_ADDRESS,
        *,
        limits: DriverLimits | None = None,
        max_sessions: int = 8,
        keys: ServerKeys | None = None,
        insecure: bool = False,
    ) -> None:
        self._zmq = zmq_module()
        self._drivers, self._limits = _checked(drivers), limits or DriverLimits()
        if type(max_sessions) is not int or max_sessions < 1:
            raise ConfigError(f"{max_sessions!r} sessions at once, expected 1 or more")
        self._max_sessions, keys = max_sessions, keys or ServerKeys()
        address = full_address(address)
        keys.check(address, insecure)
        self._guests: dict[bytes, _Guest] = {}
        self._sessions: set[Session] = set()  # those that are ending are in it too
        self._replies = f"inproc://stkzoo-replies-{next(_NUMBERS)}"
        self._stop = threading.Event()
        with contextlib.ExitStack() as life:
            self._context = life.enter_context(contextlib.closing(_Context(self._zmq))).context
            self._doorkeeper = (
                ClientAuthenticator(self._context, keys.allowed) if keys.own else None
            )
            if self._doorkeeper is not None:
                life.callback(self._doorkeeper.socket.close, 0)
            self._outbox = self._context.socket(self._zmq.PULL)
            life.callback(self._outbox.close, 0)
            self._outbox.bind(self._replies)
            self._socket = server_socket(self._context, address, keys)
            life.callback(self._socket.close, 0)
            self._life = life.pop_all()
        #: Where it listens, with the port it has.
        self.address: str = self._socket.getsockopt_string(self._zmq.LAST_ENDPOINT)

    def __enter__(self) -> RaceServer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def serve(self) -> None:
        """Serves until :meth:`stop` is called; no client can end it."""
        poller = self._zmq.Poller()
        jobs: dict[Any, Callable[[], object]] = {
            self._socket: self._receive,
            self._outbox: self._send_replies,
        }
        if self._doorkeeper is not None:
            jobs[self._doorkeeper.socket] = self._open_door
        for socket in jobs:
            poller.register(socket, self._zmq.POLLIN)
        look_after = time.monotonic() + 1
        while not self._stop.is_set():
            for socket, _ in poller.poll(500):
                jobs[socket]()
            if time.monotonic() > look_after:
                self._look_after_guests()
                look_after = time.monotonic() + 1

    def stop(self) -> None:
        """Lets :meth:`serve` return soon; may be called in any thread."""
        self._stop.set()

    def close(self) -> None:
        """Ends all sessions and frees the address; call it where :meth:`serve` ran."""
        for session in self._sessions:
            session.end()
        deadline = time.monotonic() + _GRACE
        for session in self._sessions:
            session.join(max(0.0, deadline - time.monotonic()))
        if any(session.is_alive() for session in self._sessions):
            self._socket.close(0)  # their own sockets are not ours to close
        else:
            self._life.close()

    # ------------------------------------------------------------------ what comes in

    def _receive(self) -> None:
        """Takes what has come, but not for ever."""
        for _ in range(100):
            try:
                identity = self._socket.recv(self._zmq.NOBLOCK)
            except self._zmq.Again:
                return
            frames: list[bytes] = []
            while self._socket.getsockopt(self._zmq.RCVMORE):
                frame = self._socket.recv()
                if len(frames) < 3:
                    frames.append(frame)
            try:
                self._dispatch(identity, frames)
            except Exception:  # noqa: BLE001 - no client may end the server, whatever was overlooked
                _log.exception("a message could not be dealt with")
                self._dismiss(identity)

    def _dispatch(self, identity: bytes, frames: list[bytes]) -> None:
        if len(frames) != 2:
            self._refuse(identity, f"{len(frames)} frames came, expected a kind and a body")
            return
        kind, body = frames
        guest = self._guests.get(identity)
        if kind == HELLO:
            self._welcome(identity, body)
        elif kind == BYE:
            self._dismiss(identity)
        elif guest is not None:
            guest.heard = time.monotonic()
            if not guest.session.put(kind, body):
                self._refuse(identity, "too many messages at once")
        elif kind == OPEN:
            self._admit(identity, body)
        elif kind != CLOSE:
            self._refuse(identity, f"message kind {kind!r:.20} came, expected one of H, O first")

    def _welcome(self, identity: bytes, body: bytes) -> None:
        try:
            take_version(unpack(body, limits=_HELLO_LIMITS))
        except ProtocolError as error:
            self._refuse(identity, str(error))
            return
        agents = [[own.name, own.source, own.sees_ground] for own in self._drivers]
        limit = self._limits.action_timeout
        body = pack(protocol=VERSION, stkzoo=version("stkzoo"), agents=agents, action_timeout=limit)
        self._send(identity, WELCOME, body)

    def _admit(self, identity: bytes, body: bytes) -> None:
        self._sessions = {session for session in self._sessions if session.is_alive()}
        is_full = len(self._guests) >= self._max_sessions
        if is_full or len(self._sessions) >= 2 * self._max_sessions:
            self._refuse(
                identity, f"the server is busy: all of its {self._max_sessions} sessions are taken"
            )
            return
        session = Session(self._drivers, self._limits, lambda: self._replier(identity))
        now = time.monotonic()
        self._guests[identity] = _Guest(session, now, now)
        session.put(OPEN, body)
        session.start()
        self._sessions.add(session)
        _log.info("a client came; %d of %d sessions", len(self._guests), self._max_sessions)

    def _open_door(self) -> None:
        assert self._doorkeeper is not None  # noqa: S101 - it has a socket
        if not self._doorkeeper.answer():
            _log.warning("a client without an allowed key was turned away")

    # ------------------------------------------------------------------ what goes out

    def _send(self, identity: bytes, kind: bytes, body: bytes) -> bool:
        """Whether the client is there, and takes what it is sent."""
        try:
            self._socket.send_multipart([identity, kind, body], self._zmq.NOBLOCK)
        except self._zmq.ZMQError:
            return False
        return True

    def _refuse(self, identity: bytes, text: str) -> None:
        """Tells a client why it is not served, and ends its session if it has one."""
        self._send(identity, ERROR, pack(text=text))
        self._dismiss(identity)

    def _dismiss(self, identity: bytes) -> None:
        guest = self._guests.pop(identity, None)
        if guest is not None:
            guest.session.end()
            _log.info("a client left; %d of %d sessions", len(self._guests), self._max_sessions)

    @contextlib.contextmanager
    def _replier(self, identity: bytes) -> Iterator[Reply]:
        """The way from a session's thread to its client, through the server's own."""
        with self._context.socket(self._zmq.PUSH) as outbox:
            outbox.setsockopt(self._zmq.LINGER, 0)
            outbox.connect(self._replies)
            yield lambda kind, body: outbox.send_multipart([identity, kind, body])

    def _send_replies(self) -> None:
        for _ in range(100):
            try:
                identity, kind, body = self._outbox.recv_multipart(self._zmq.NOBLOCK)
            except self._zmq.Again:
                return
            if not kind or not self._send(identity, kind, body):
                self._dismiss(identity)
            elif identity in self._guests:
                self._guests[identity].asked = time.monotonic()

    def _look_after_guests(self) -> None:
        """Lets go of clients that are gone."""
        now = time.monotonic()
        for identity, guest in list(self._guests.items()):
            if now - guest.heard > _PATIENCE:
                self._refuse(identity, f"the client said nothing for {_PATIENCE:g} s")
            elif guest.is_to_be_asked(now):
                guest.asked = now
                if not self._send(identity, ALIVE, b""):
                    self._dismiss(identity)


class _Context:
    """A ZeroMQ context that closes without waiting for anybody."""

    def __init__(self, zmq: Any) -> None:
        self.context = zmq.Context()

    def close(self) -> None:
        self.context.destroy(linger=0)


def _checked(drivers: Sequence[Driver]) -> list[Driver]:
    if not drivers:
        raise ConfigError("a server without agents; name at least one")
    for driver in drivers:
        if driver.is_game_ai:
            raise ConfigError("the game's AI drives where the game runs; name it at the client")
    return list(drivers)
