"""The agent server, whose agents drive in races on other machines."""

from __future__ import annotations

import contextlib
import itertools
import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from typing import Any

from stkzoo._logs import RepeatFilter
from stkzoo.drivers.codec import Limits
from stkzoo.drivers.driver import Driver, declared_name
from stkzoo.drivers.instances import DriverLimits
from stkzoo.errors import ConfigError, ProtocolError, check_whole, shortened
from stkzoo.race.remote import protocol
from stkzoo.race.remote.peers import PeerTable
from stkzoo.race.remote.session import ClientSession, Reply
from stkzoo.race.remote.sockets import (
    DEFAULT_ADDRESS,
    ClientAuthenticator,
    ServerKeys,
    check_descriptors,
    full_address,
    server_socket,
    zmq_module,
)

logger = logging.getLogger(__name__)
logger.addFilter(RepeatFilter())

#: Time without a message after which the server ends a client's session [s].
_PATIENCE = 600.0
#: Intervals at which the server checks its connections and its sessions [s].
_PEER_CHECK, _CLIENT_CHECK = 0.1, 1.0
#: Time limit for sessions to end when the server closes [s].
_GRACE = 15.0
_HELLO_LIMITS = Limits(max_bytes=4096, max_depth=2, max_length=16)
_NUMBERS = itertools.count()
#: Messages that identify the connection of a client.
_NAMED = (protocol.HELLO, protocol.OPEN)
#: Maximum number of frames that the server discards before it serves other clients.
_MAX_DISCARDED = 1000


class RaceServer(contextlib.AbstractContextManager["RaceServer"]):
    """A server that provides agents to the races of several clients at the same time.

    The server listens when it is created. :meth:`serve` handles the messages in the thread that
    calls it.

    Args:
        drivers: drivers that clients can use; the game's AI is not allowed.
        address: address to listen on (:func:`~stkzoo.race.remote.full_address`).
        limits: resource limits of each agent; a client may request shorter time limits.
        max_sessions: maximum number of clients with a session; the server refuses further ones.
        keys: keys of the server and of its clients; ``None`` for no keys.
        insecure: allow an address that other machines can reach without keys.

    Raises:
        ConfigError: an argument is invalid, the address is not available, or pyzmq is not
            installed.
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
        check_whole("max_sessions", max_sessions, 1)
        self._max_sessions, keys = max_sessions, keys or ServerKeys()
        self._descriptions = [
            [own.name or declared_name(own.source), own.source, sorted(own.extras)]
            for own in self._drivers
        ]
        address = full_address(address)
        keys.check(address, insecure)
        self._facts = {"protocol": protocol.VERSION, "stkzoo": version("stkzoo")}
        self._clients: dict[bytes, ClientSession] = {}
        self._sessions: set[ClientSession] = set()  # including those that are ending
        self._replies = f"inproc://stkzoo-replies-{next(_NUMBERS)}"
        self._stop = threading.Event()
        check_descriptors(ConfigError)
        self._context = self._zmq.Context()
        try:
            self._authenticator = (
                ClientAuthenticator(self._context, keys.allowed) if keys.own else None
            )
            self._outbox = self._context.socket(self._zmq.PULL)
            self._outbox.bind(self._replies)
            self._socket = server_socket(self._context, address, keys)
            self._peers = PeerTable(self._socket, self._send_error)
        except BaseException:
            self._context.destroy(0)
            raise
        #: Address that the server listens on, including the port.
        self.address: str = self._socket.getsockopt_string(self._zmq.LAST_ENDPOINT)

    def __exit__(self, *exception: object) -> None:
        self.close()

    def serve(self) -> None:
        """Serves clients until :meth:`stop` is called. Errors of clients do not end it."""
        poller = self._zmq.Poller()
        jobs: dict[Any, Callable[[], object]] = {
            self._peers.socket: self._update_peers,
            self._socket: self._receive,
            self._outbox: self._send_replies,
        }
        if self._authenticator is not None:
            jobs[self._authenticator.socket] = self._authenticate
        for socket in jobs:
            poller.register(socket, self._zmq.POLLIN)
        checks = [(self._peers.check, _PEER_CHECK), (self._check_clients, _CLIENT_CHECK)]
        due = [time.monotonic() + period for _, period in checks]
        while not self._stop.is_set():
            for socket, _ in poller.poll(int(1000 * _PEER_CHECK)):
                jobs[socket]()
            for number, (check, period) in enumerate(checks):
                if time.monotonic() > due[number]:
                    check()
                    due[number] = time.monotonic() + period

    def stop(self) -> None:
        """Makes :meth:`serve` return soon; may be called from any thread."""
        self._stop.set()

    def close(self) -> None:
        """Ends all sessions and releases the address. Call it in the thread of :meth:`serve`."""
        for session in self._sessions:
            session.end()
        deadline = time.monotonic() + _GRACE
        for session in self._sessions:
            session.join(max(0.0, deadline - time.monotonic()))
        self._peers.close()
        if any(session.is_alive() for session in self._sessions):
            self._socket.close(0)  # a socket must not be closed outside its thread
        else:
            self._context.destroy(0)  # also closes its sockets

    # ------------------------------------------------------------------ incoming messages

    def _receive(self) -> None:
        """Handles up to 20 queued messages, or discards a part of a long one."""
        for _ in range(20):  # excess connections are closed before further messages
            if not self._discard_rest():
                return
            try:
                identity = self._socket.recv(self._zmq.NOBLOCK)
            except self._zmq.Again:
                return
            frames, origin = self._frames()
            if not self._discard_rest():
                self._peers.cut(origin)
                self._dismiss(identity)
                return
            try:
                if origin is not None and frames[0] in _NAMED:
                    self._peers.name(origin, identity)
                self._dispatch(identity, frames)
            except Exception:  # a client must not end the server
                logger.exception("a message could not be handled")
                self._dismiss(identity)

    def _frames(self) -> tuple[list[bytes], Any]:
        """Returns the first three frames of a message, and the first as ZeroMQ's object."""
        frames: list[bytes] = []
        origin: Any = None
        while len(frames) < 3 and self._socket.getsockopt(self._zmq.RCVMORE):
            if origin is None:
                origin = self._socket.recv(copy=False)
                frames.append(origin.bytes)
            else:
                frames.append(self._socket.recv())
        return frames, origin

    def _discard_rest(self) -> bool:
        """Discards further frames of a message and returns whether none are left."""
        for _ in range(_MAX_DISCARDED):
            if not self._socket.getsockopt(self._zmq.RCVMORE):
                return True
            self._socket.recv()
        return False

    def _dispatch(self, identity: bytes, frames: list[bytes]) -> None:
        self._peers.count(identity, sum(map(len, frames)))
        if len(frames) != 2:
            self._refuse(identity, f"received {len(frames)} frames, expected a kind and a body")
            return
        kind, body = frames
        client = self._clients.get(identity)
        if kind == protocol.HELLO:
            self._welcome(identity, body)
        elif kind == protocol.BYE:
            self._dismiss(identity)
        elif client is not None:
            client.heard = time.monotonic()
            if not client.put(kind, body):
                self._refuse(identity, "too many messages at once")
        elif kind == protocol.OPEN:
            self._admit(identity, body)
        elif kind != protocol.CLOSE:
            self._refuse(
                identity, f"message kind {shortened(kind, 20)} came, expected one of H, O first"
            )

    def _welcome(self, identity: bytes, body: bytes) -> None:
        try:
            protocol.check_version(protocol.unpack(body, limits=_HELLO_LIMITS))
        except ProtocolError as error:
            self._refuse(identity, str(error))
            return
        agents = self._descriptions
        limit = self._limits.action_timeout
        body = protocol.pack(**self._facts, agents=agents, action_timeout=limit)
        self._send(identity, protocol.WELCOME, body)

    def _admit(self, identity: bytes, body: bytes) -> None:
        self._sessions = {session for session in self._sessions if session.is_alive()}
        is_full = len(self._clients) >= self._max_sessions
        if is_full or len(self._sessions) >= 2 * self._max_sessions:
            self._refuse(
                identity, f"the server is busy: all of its {self._max_sessions} sessions are taken"
            )
            return
        self._peers.begin_session(identity)
        session = ClientSession(self._drivers, self._limits, lambda: self._replier(identity))
        self._clients[identity] = session
        session.put(protocol.OPEN, body)
        session.start()
        self._sessions.add(session)
        logger.info("client connected; %d of %d sessions", len(self._clients), self._max_sessions)

    def _update_peers(self) -> None:
        if self._peers.update():
            logger.warning("too many connections; closing the oldest ones without a race")

    def _authenticate(self) -> None:
        assert self._authenticator is not None  # noqa: S101 - it has a socket
        if not self._authenticator.answer():
            logger.warning("refused a client whose key is not allowed")

    # ------------------------------------------------------------------ outgoing messages

    def _send(self, identity: bytes, kind: bytes, body: bytes) -> bool:
        """Sends a message and returns whether ZeroMQ accepted it for the client."""
        try:
            self._socket.send_multipart([identity, kind, body], self._zmq.NOBLOCK)
        except self._zmq.ZMQError:
            return False
        return True

    def _send_error(self, identity: bytes, text: str) -> None:
        self._send(identity, protocol.ERROR, protocol.pack(text=text))

    def _refuse(self, identity: bytes, text: str) -> None:
        """Sends a client the reason for its refusal and ends its session if it has one."""
        self._send_error(identity, text)
        self._dismiss(identity)

    def _dismiss(self, identity: bytes) -> None:
        client = self._clients.pop(identity, None)
        if client is not None:
            client.end()
            self._peers.end_session(identity)
            logger.info(
                "client disconnected; %d of %d sessions", len(self._clients), self._max_sessions
            )

    @contextlib.contextmanager
    def _replier(self, identity: bytes) -> Iterator[Reply]:
        """Yields a function that sends from a session's thread to its client.

        The messages pass through the server's thread, because only it may use the server's socket.
        """
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
            elif identity in self._clients:
                self._clients[identity].pinged = time.monotonic()

    def _check_clients(self) -> None:
        """Pings silent clients; ends sessions of clients that disconnected or timed out."""
        now = time.monotonic()
        for identity, client in list(self._clients.items()):
            if now - client.heard > _PATIENCE:
                self._refuse(identity, f"no message from the client for {_PATIENCE:g} s")
            elif client.needs_ping(now):
                client.pinged = now
                if not self._send(identity, protocol.ALIVE, b""):
                    self._dismiss(identity)


def _checked(drivers: Sequence[Driver]) -> list[Driver]:
    if not drivers:
        raise ConfigError("the server has no agents; name at least one")
    for driver in drivers:
        if driver.is_game_ai:
            raise ConfigError("the game's AI runs in the game; name it on the client")
        if driver.words:
            raise ConfigError(
                f"{driver.name or driver.source} talks, but servers do not carry words; run it on "
                "the machine of the race"
            )
    return list(drivers)
