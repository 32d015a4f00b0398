"""The agent server, whose agents drive in races on other machines."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from queue import SimpleQueue
from typing import Any

from stkzoo._checks import check_whole
from stkzoo._logs import RepeatFilter
from stkzoo._schema import plain_name
from stkzoo.drivers.driver import Driver, declared_name
from stkzoo.drivers.failures import MAX_TEXT, printable
from stkzoo.drivers.instances import DriverInstance, DriverLimits, DriverRequest
from stkzoo.drivers.messages import (
    Decided,
    Failed,
    Message,
    Ready,
    Reply,
    decode_observation,
    encode,
    start_reply,
)
from stkzoo.errors import ConfigError, ProtocolError
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space
from stkzoo.race.remote import protocol, sockets

logger = logging.getLogger(__name__)
logger.addFilter(RepeatFilter())

#: Time without a message after which the server ends a session [s].
_PATIENCE = 600.0
#: Interval at which the server checks its sessions [s].
_CHECK = 1.0
#: Time after which the server notices :meth:`RaceServer.stop` [ms].
_POLL = 100
#: Time limit for sessions to end when the server closes [s].
_GRACE = 15.0
#: Address within the server for replies from sessions.
_REPLIES = "inproc://replies"
#: Held while an agent runs in this process, because its modules take the place of other agents'.
_in_process = threading.Lock()


class RaceServer(AbstractContextManager["RaceServer"]):
    """A server that provides agents to the races of several clients at the same time.

    The server listens when it is created. :meth:`serve` handles the messages in the thread that
    calls it.

    Args:
        drivers: drivers that clients can use; the game's AI is not allowed.
        address: address to listen on such as ``127.0.0.1:5555`` or ``*:5555``; the port may be
            ``*`` for any free one.
        limits: resource limits of each agent; a client may request shorter time limits.
        max_sessions: maximum number of clients whose agents run; the server refuses further ones.
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
        self._max_clients, keys = max_sessions, keys or sockets.ServerKeys()
        self._welcome = encode(
            protocol.Welcome(protocol.VERSION, version("stkzoo"), [*map(_offer, self._drivers)])
        )
        address = sockets.full_address(address)
        keys.check(address, insecure)
        self._sessions: dict[bytes, AgentSession] = {}  # by the identity of the connection
        self._threads: set[AgentSession] = set()  # including those that are ending
        self._stop = threading.Event()
        self._context = self._zmq.Context()
        try:
            self._authenticator = (
                sockets.ClientAuthenticator(self._context, keys.allowed) if keys.pair else None
            )
            self._outbox = self._context.socket(self._zmq.PULL)
            self._outbox.bind(_REPLIES)
            self._replies = self._context.socket(self._zmq.PUSH)
            self._replies.connect(_REPLIES)
            self._lock = threading.Lock()  # of the replies, which all sessions send
            self._socket = sockets.server_socket(self._context, address, keys)
            #: Address that the server listens on, including the port.
            self.address: str = self._socket.getsockopt_string(self._zmq.LAST_ENDPOINT)
            self._connections = sockets.Connections(self._socket)
        except BaseException:
            self._context.destroy(0)
            raise

    def __exit__(self, *exception: object) -> None:
        self.close()

    def serve(self) -> None:
        """Serves clients until :meth:`stop` is called. Errors of clients do not end it."""
        poller = self._zmq.Poller()
        jobs: dict[Any, Callable[[], object]] = {
            self._connections.socket: self._end_lost_sessions,
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
                self._end_silent_sessions()
                due = time.monotonic() + _CHECK

    def stop(self) -> None:
        """Makes :meth:`serve` return soon; may be called from any thread."""
        self._stop.set()

    def close(self) -> None:
        """Ends all sessions and releases the address. Call it in the thread of :meth:`serve`."""
        for thread in self._threads:
            thread.put(None)
        deadline = time.monotonic() + _GRACE
        for thread in self._threads:
            thread.join(max(0.0, deadline - time.monotonic()))
        self._connections.close()
        if any(thread.is_alive() for thread in self._threads):
            self._socket.close(0)  # a socket must not be closed outside its thread
        else:
            self._context.destroy(0)  # also closes its sockets

    # ------------------------------------------------------------------ incoming messages

    def _receive(self) -> None:
        self._end_lost_sessions()  # before a new connection has the same descriptor
        sender, *parts = self._socket.recv_multipart(copy=False)
        identity, descriptor = sender.bytes, sender.get(self._zmq.SRCFD)
        if descriptor not in self._connections.identities:
            return
        self._connections.identities[descriptor] = identity
        try:
            self._handle(identity, protocol.read_request([part.bytes for part in parts]))
        except ProtocolError as error:
            self._refuse(identity, str(error))

    def _handle(self, identity: bytes, message: protocol.ClientMessage) -> None:
        session = self._sessions.get(identity)
        match message:
            case protocol.Hello():
                self._send(identity, self._welcome)
            case protocol.Bye():
                self._end(identity)
            case protocol.Open() if session is None:
                self._admit(identity, message)
            case protocol.Act(observation) if session is not None and not session.is_busy:
                session.heard = time.monotonic()
                session.put(observation)
            case _:
                raise ProtocolError("a request came before the reply to the last one, or no agent")

    def _admit(self, identity: bytes, opening: protocol.Open) -> None:
        """Starts an agent.

        Raises:
            ProtocolError: the server has no such agent, or no place for it.
        """
        self._threads = {thread for thread in self._threads if thread.is_alive()}
        clients = [session.client for session in self._sessions.values()]
        is_full = len({*clients, opening.client}) > self._max_clients
        if is_full or len(self._threads) >= 2 * self._max_clients * protocol.MAX_AGENTS:
            raise ProtocolError(
                f"the server is busy: all of its {self._max_clients} sessions are taken"
            )
        if clients.count(opening.client) >= protocol.MAX_AGENTS:
            raise ProtocolError(f"a client has at most {protocol.MAX_AGENTS} agents on a server")
        if opening.driver >= len(self._drivers):
            raise ProtocolError(f"driver {opening.driver}, expected 0 to {len(self._drivers) - 1}")
        driver, reply = self._drivers[opening.driver], partial(self._reply, identity)
        session = AgentSession(driver, self._limits, opening, reply)
        session.start()
        self._sessions[identity] = session
        self._threads.add(session)
        if opening.client not in clients:
            logger.info("client connected; %d of %d", len({*clients}) + 1, self._max_clients)

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
        self._end(identity)

    def _end(self, identity: bytes) -> None:
        """Ends the session of a connection if it has one."""
        session = self._sessions.pop(identity, None)
        if session is None:
            return
        session.put(None)
        clients = {other.client for other in self._sessions.values()}
        if session.client not in clients:
            logger.info("client disconnected; %d of %d", len(clients), self._max_clients)

    def _end_lost_sessions(self) -> None:
        for identity in self._connections.update():
            self._end(identity)

    def _end_silent_sessions(self) -> None:
        for identity, session in list(self._sessions.items()):
            if time.monotonic() - session.heard > _PATIENCE:
                self._refuse(identity, f"no message from the client for {_PATIENCE:g} s")

    def _reply(self, identity: bytes, message: Message | None) -> None:
        """Sends a message from a session's thread to its client; ``None`` ends the session.

        The messages pass through the server's thread, because only it may use the server's socket.
        """
        data = b"" if message is None else encode(message)
        with self._lock:
            self._replies.send_multipart([identity, data])

    def _send_reply(self) -> None:
        identity, data = self._outbox.recv_multipart()
        session = self._sessions.get(identity)
        if session is not None:
            session.is_busy = False
        if not data or not self._send(identity, data):
            self._end(identity)


def _offer(driver: Driver) -> protocol.Offer:
    name = driver.name or declared_name(driver.source)
    return protocol.Offer(
        plain_name(name), printable(driver.source, MAX_TEXT), sorted(driver.extras)
    )


def _checked(drivers: Sequence[Driver]) -> list[Driver]:
    if not drivers:
        raise ConfigError("the server has no agents; name at least one")
    if any(driver.is_game_ai for driver in drivers):
        raise ConfigError("the game's AI runs in the game; name it on the client")
    return list(drivers)


class AgentSession(threading.Thread):
    """A thread that runs an agent for a client.

    The thread itself starts the agent, because some agents end with the thread that started them.

    Args:
        driver: the driver; not the game's AI.
        limits: resource limits of the agent.
        opening: the client's request.
        reply: sends a message to the client; ``None`` ends the session. The thread calls it.

    Attributes:
        client: the client.
        heard: time of the client's last message (:func:`time.monotonic`).
        is_busy: whether the thread has not replied to the client's last message.
    """

    def __init__(
        self,
        driver: Driver,
        limits: DriverLimits,
        opening: protocol.Open,
        reply: Callable[[Message | None], None],
    ) -> None:
        super().__init__(name="stkzoo-session", daemon=True)
        self._driver, self._reply = driver, reply
        self._request = _driver_request(opening, limits)
        self.client, self.heard, self.is_busy = opening.client, time.monotonic(), True
        self._inbox: SimpleQueue[bytes | None] = SimpleQueue()
        self._agent: DriverInstance | None = None

    def put(self, observation: bytes | None) -> None:
        """Gives the agent an encoded observation; ``None`` ends the thread."""
        self.is_busy = True
        self._inbox.put(observation)

    def run(self) -> None:
        """Serves the client until the end of the session or an error."""
        try:
            self._serve()
        except Exception:  # the server continues after any error
            logger.exception("a session failed")
            self._reply(protocol.Refused("the session is over: the server failed"))
        finally:
            self._reply(None)
            if self._agent is not None:
                with self._turn():
                    self._agent.close()

    def _serve(self) -> None:
        reply: Reply = self._start()
        self._reply(reply)
        while not isinstance(reply, Failed) or reply.is_usable:
            observation = self._inbox.get()
            if observation is None:
                return
            reply = self._act(observation)
            self._reply(reply)

    def _start(self) -> Ready | Failed:
        assert self._driver.start is not None  # noqa: S101 - the server refuses the game's AI
        try:
            self._agent = self._driver.start(self._request)
        except Exception as error:  # noqa: BLE001 - an agent may raise anything
            return Failed.of(error)
        with self._turn():
            return start_reply(self._agent)

    def _act(self, observation: bytes) -> Decided | Failed:
        agent = self._agent
        assert agent is not None  # noqa: S101 - it is ready
        try:
            with self._turn():
                agent.ask(observation if self._is_isolated else decode_observation(observation))
                return Decided.of(agent.answer())
        except Exception as error:  # noqa: BLE001 - an agent may raise anything
            return Failed.of(error, is_usable=bool(agent.is_usable))

    @property
    def _is_isolated(self) -> bool:
        """Whether another process runs the agent, and decodes its observations."""
        return getattr(self._agent, "takes_encoded", False)

    def _turn(self) -> AbstractContextManager[object]:
        """Returns a context in which the agent may run."""
        return nullcontext() if self._is_isolated else _in_process


def _driver_request(opening: protocol.Open, limits: DriverLimits) -> DriverRequest:
    action_timeout = opening.action_timeout
    if limits.action_timeout is not None:
        action_timeout = min(action_timeout or limits.action_timeout, limits.action_timeout)
    return DriverRequest(
        agent=printable(opening.agent),
        observation_space=kart_observation_space(extras=opening.extras),
        action_space=kart_action_space(),
        seed=opening.seed,
        limits=replace(
            limits,
            action_timeout=action_timeout,
            start_timeout=min(limits.start_timeout, opening.start_timeout),
        ),
    )
