"""The agent server, whose agents drive in races on other machines."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from typing import Any

from stkzoo._checks import check_whole
from stkzoo._logs import RepeatFilter
from stkzoo.drivers.driver import Driver, declared_name
from stkzoo.drivers.failures import MAX_TEXT, printable
from stkzoo.drivers.instances import DriverLimits
from stkzoo.drivers.messages import MAX_NAME, Message, encode
from stkzoo.errors import ConfigError, ProtocolError
from stkzoo.race.remote import protocol, sockets
from stkzoo.race.remote.session import ClientSession, Reply

logger = logging.getLogger(__name__)
logger.addFilter(RepeatFilter())

#: Time without a message after which the server ends a client's session [s].
_PATIENCE = 600.0
#: Time after which the server pings a silent client, to see whether it is still connected [s].
_PING = 5.0
#: Interval at which the server checks its sessions [s].
_CHECK = 1.0
#: Time after which the server notices :meth:`RaceServer.stop` [ms].
_POLL = 100
#: Time limit for sessions to end when the server closes [s].
_GRACE = 15.0
#: Address within the server for replies from sessions.
_REPLIES = "inproc://replies"
_ALIVE = encode(protocol.Alive())


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
        address: str = sockets.DEFAULT_ADDRESS,
        *,
        limits: DriverLimits | None = None,
        max_sessions: int = 8,
        keys: sockets.ServerKeys | None = None,
        insecure: bool = False,
    ) -> None:
        self._zmq = sockets.zmq_module()
        self._drivers, self._limits = _checked(drivers), limits or DriverLimits()
        check_whole("max_sessions", max_sessions, 1)
        self._max_sessions, keys = max_sessions, keys or sockets.ServerKeys()
        self._welcome = encode(
            protocol.Welcome(protocol.VERSION, version("stkzoo"), [*map(_offer, self._drivers)])
        )
        address = sockets.full_address(address)
        keys.check(address, insecure)
        self._clients: dict[bytes, ClientSession] = {}
        self._sessions: set[ClientSession] = set()  # including those that are ending
        self._stop = threading.Event()
        self._context = self._zmq.Context()
        try:
            self._authenticator = (
                sockets.ClientAuthenticator(self._context, keys.allowed) if keys.own else None
            )
            self._outbox = self._context.socket(self._zmq.PULL)
            self._outbox.bind(_REPLIES)
            self._socket = sockets.server_socket(self._context, address, keys)
            #: Address that the server listens on, including the port.
            self.address: str = self._socket.getsockopt_string(self._zmq.LAST_ENDPOINT)
            self._connections = sockets.ConnectionLimit(self._socket)
        except BaseException:
            self._context.destroy(0)
            raise

    def __exit__(self, *exception: object) -> None:
        self.close()

    def serve(self) -> None:
        """Serves clients until :meth:`stop` is called. Errors of clients do not end it."""
        poller = self._zmq.Poller()
        jobs: dict[Any, Callable[[], object]] = {
            self._connections.socket: self._connections.update,
            self._socket: self._receive,
            self._outbox: self._send_reply,
        }
        if self._authenticator is not None:
            jobs[self._authenticator.socket] = self._authenticator.answer
        for socket in jobs:
            poller.register(socket, self._zmq.POLLIN)
        due = time.monotonic() + _CHECK
        while not self._stop.is_set():
            for socket, _ in poller.poll(_POLL):
                jobs[socket]()
            if time.monotonic() > due:
                self._check_clients()
                due = time.monotonic() + _CHECK

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
        self._connections.close()
        if any(session.is_alive() for session in self._sessions):
            self._socket.close(0)  # a socket must not be closed outside its thread
        else:
            self._context.destroy(0)  # also closes its sockets

    # ------------------------------------------------------------------ incoming messages

    def _receive(self) -> None:
        identity, *frames = self._socket.recv_multipart()
        try:
            self._handle(identity, protocol.read_request(frames), len(frames[0]))
        except ProtocolError as error:
            self._refuse(identity, str(error))

    def _handle(self, identity: bytes, message: protocol.ClientMessage, size: int) -> None:
        client = self._clients.get(identity)
        match message:
            case protocol.Hello():
                self._send(identity, self._welcome)
            case protocol.Bye():
                self._dismiss(identity)
            case _ if client is not None:
                client.heard = time.monotonic()
                if not client.put(message, size):
                    raise ProtocolError("too many messages at once")
            case protocol.Open():
                self._admit(identity, message, size)
            case protocol.Act():
                raise ProtocolError("observations came before a seat was requested")

    def _admit(self, identity: bytes, message: protocol.Open, size: int) -> None:
        self._sessions = {session for session in self._sessions if session.is_alive()}
        is_full = len(self._clients) >= self._max_sessions
        if is_full or len(self._sessions) >= 2 * self._max_sessions:
            self._refuse(
                identity, f"the server is busy: all of its {self._max_sessions} sessions are taken"
            )
            return
        session = ClientSession(self._drivers, self._limits, lambda: self._replier(identity))
        self._clients[identity] = session
        session.put(message, size)
        session.start()
        self._sessions.add(session)
        logger.info("client connected; %d of %d sessions", len(self._clients), self._max_sessions)

    # ------------------------------------------------------------------ outgoing messages

    def _send(self, identity: bytes, data: bytes) -> bool:
        """Sends an encoded message and returns whether ZeroMQ accepted it for the client."""
        try:
            self._socket.send_multipart([identity, data], self._zmq.NOBLOCK)
        except self._zmq.ZMQError:
            return False
        return True

    def _refuse(self, identity: bytes, reason: str) -> None:
        """Sends a client the reason for its refusal and ends its session if it has one."""
        self._send(identity, encode(protocol.Refused(reason)))
        self._dismiss(identity)

    def _dismiss(self, identity: bytes) -> None:
        client = self._clients.pop(identity, None)
        if client is not None:
            client.end()
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
            outbox.connect(_REPLIES)

            def reply(message: Message | None) -> None:
                outbox.send_multipart([identity, b"" if message is None else encode(message)])

            yield reply

    def _send_reply(self) -> None:
        identity, data = self._outbox.recv_multipart()
        if not data or not self._send(identity, data):
            self._dismiss(identity)
        elif identity in self._clients:
            self._clients[identity].pinged = time.monotonic()

    def _check_clients(self) -> None:
        """Pings silent clients; ends sessions of clients that disconnected or timed out."""
        now = time.monotonic()
        for identity, client in list(self._clients.items()):
            if now - client.heard > _PATIENCE:
                self._refuse(identity, f"no message from the client for {_PATIENCE:g} s")
            elif now - max(client.heard, client.pinged) > _PING:
                client.pinged = now
                if not self._send(identity, _ALIVE):
                    self._dismiss(identity)


def _offer(driver: Driver) -> protocol.Offer:
    name = driver.name or declared_name(driver.source)
    return protocol.Offer(
        printable(name, MAX_NAME), printable(driver.source, MAX_TEXT), sorted(driver.extras)
    )


def _checked(drivers: Sequence[Driver]) -> list[Driver]:
    if not drivers:
        raise ConfigError("the server has no agents; name at least one")
    for driver in drivers:
        if driver.is_game_ai:
            raise ConfigError("the game's AI runs in the game; name it on the client")
    return list(drivers)
