"""Limits the number of a server's connections and closes idle or abusive ones."""

from __future__ import annotations

import os
import socket
import struct
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from stkzoo._os import bytes_received, max_descriptors, network_of
from stkzoo.race.remote.sockets import MAX_UNREAD, OVERHEAD, zmq_module

#: Connections use at most 1/4 of the process's file descriptors; agents need the others.
_SHARE = 4
_MOST, _LEAST = 1024, 16
#: Number of additional connections that may wait until their last message is sent.
_SPARE = 32
#: Time after which a connection without a session is closed [s].
IDLE = 30.0
#: Maximum unread data of a connection without a session [bytes]; 32 requests for seats need a
#: quarter. A frame on the wire may have only 2 bytes, but takes 1 µs to discard.
_MAX_UNREAD_IDLE = 64 << 10
#: Time limit for a closing connection to receive its last message [s].
_FAREWELL = 0.2

_TOO_MANY = "the server has too many connections, and this one has no race; try again later"
_IDLE_TOO_LONG = f"the connection had no race for {IDLE:g} s; connect again when a race starts"


@dataclass(slots=True)
class _Peer:
    """One connection.

    Attributes:
        ends: local and remote address. They show whether a file descriptor still belongs to this
            connection.
        network: network of the client, by which connections are counted.
        since: when the connection was accepted, or its last session ended
            (:func:`time.monotonic`).
        identity: ZeroMQ's identity of the client; empty until it has sent a message.
        has_session: whether it has a session.
        num_read: number of bytes that the server has read from it.
        leaves_at: when the connection is shut down (:func:`time.monotonic`); ``None`` if it may
            stay.
    """

    ends: tuple[Any, Any]
    network: str
    since: float
    identity: bytes = b""
    has_session: bool = False
    num_read: int = 0
    leaves_at: float | None = None


class _Window:
    """Accesses connections by their file descriptors through a reserved descriptor.

    This works even if the process has no other descriptors left.
    """

    def __init__(self) -> None:
        self._null = os.open(os.devnull, os.O_RDONLY)
        self._own = os.dup(self._null)

    @contextmanager
    def onto(self, descriptor: int) -> Iterator[socket.socket]:
        """Opens the connection behind a descriptor, even if ZeroMQ closes the descriptor.

        Raises:
            OSError: the connection no longer exists.
        """
        os.dup2(descriptor, self._own, inheritable=False)
        try:
            connection = socket.socket(fileno=self._own)
            try:
                yield connection
            finally:
                connection.detach()
        finally:
            os.dup2(self._null, self._own, inheritable=False)

    def close(self) -> None:
        """Closes the reserved descriptors."""
        os.close(self._own)
        os.close(self._null)


class PeerTable:
    """Tracks the connections of a ROUTER socket and limits their number.

    ZeroMQ accepts connections until the process has no file descriptors left, and has no call that
    closes one. This table learns of each connection from ZeroMQ's events and closes it by a
    shutdown of its descriptor. At the limit, a new connection replaces one without a session: the
    oldest one of the network with the most such connections.

    Args:
        router: the socket.
        refuse: sends a reason to a client, given its identity.

    Attributes:
        socket: socket with ZeroMQ's events. Call :meth:`update` when it is readable.
    """

    def __init__(self, router: Any, refuse: Callable[[bytes, str], None]) -> None:
        self._zmq, self._router, self._refuse = zmq_module(), router, refuse
        self._most = max(_LEAST, min(_MOST, max_descriptors() // _SHARE))
        self._peers: dict[int, _Peer] = {}  # by descriptor, oldest first
        self._by_identity: dict[bytes, _Peer] = {}
        self._window = _Window()
        self.socket = router.get_monitor_socket(
            self._zmq.EVENT_ACCEPTED | self._zmq.EVENT_DISCONNECTED
        )

    def close(self) -> None:
        """Stops tracking. Call it before you close the router."""
        self._router.disable_monitor()
        self.socket.close(0)
        self._window.close()

    def update(self) -> bool:
        """Handles up to 1000 events and returns whether there were too many connections."""
        for _ in range(1000):
            try:
                event, _ = self.socket.recv_multipart(self._zmq.NOBLOCK)
            except self._zmq.Again:
                break
            kind, descriptor = struct.unpack("=HI", event)
            self._forget(descriptor)
            if kind == self._zmq.EVENT_ACCEPTED:
                self._add(descriptor)
        return self._make_room()

    def name(self, frame: Any, identity: bytes) -> None:
        """Records the connection of a client.

        Args:
            frame: frame of a message from the client.
            identity: ZeroMQ's identity of the client.
        """
        _, peer = self._origin(frame)
        if peer is not None:
            peer.identity = identity
            self._by_identity[identity] = peer

    def cut(self, frame: Any) -> None:
        """Shuts down the connection of a client at once.

        Args:
            frame: frame of a message from the client.
        """
        descriptor, peer = self._origin(frame)
        if peer is not None:
            self._shut(descriptor, peer)

    def begin_session(self, identity: bytes) -> None:
        """Records that a client has a session."""
        if (peer := self._by_identity.get(identity)) is not None:
            peer.has_session = True

    def count(self, identity: bytes, size: int) -> None:
        """Records that the server has read a message of ``size`` bytes from a client."""
        if (peer := self._by_identity.get(identity)) is not None:
            peer.num_read += size + OVERHEAD

    def end_session(self, identity: bytes) -> None:
        """Records that a client's session has ended."""
        if (peer := self._by_identity.get(identity)) is not None:
            peer.has_session, peer.since = False, time.monotonic()

    def check(self) -> None:
        """Closes connections that are idle for too long or have sent too much data."""
        now = time.monotonic()
        for descriptor, peer in list(self._peers.items()):
            if peer.leaves_at is not None:
                if now >= peer.leaves_at:
                    self._shut(descriptor, peer)
            elif not peer.has_session and now - peer.since > IDLE:
                self._end(peer, _IDLE_TOO_LONG)
            elif self._unread(descriptor, peer) > 0:
                self._shut(descriptor, peer)

    def _origin(self, frame: Any) -> tuple[int, _Peer | None]:
        """Returns the descriptor and the connection from which a frame came, if it is known."""
        try:
            descriptor = int(frame.get("__fd"))
        except (self._zmq.ZMQError, ValueError):  # a transport without descriptors
            return -1, None
        return descriptor, self._peers.get(descriptor)

    def _add(self, descriptor: int) -> None:
        try:
            with self._window.onto(descriptor) as connection:
                ends = connection.getsockname(), connection.getpeername()
        except OSError:  # the connection is already closed
            return
        host = ends[1][0] if isinstance(ends[1], tuple) else ""
        self._peers[descriptor] = _Peer(ends, network_of(host), time.monotonic())

    def _forget(self, descriptor: int) -> None:
        peer = self._peers.pop(descriptor, None)
        if peer is not None and self._by_identity.get(peer.identity) is peer:
            del self._by_identity[peer.identity]

    def _make_room(self) -> bool:
        """Closes connections without a session down to the limit.

        Returns:
            Whether there were too many connections.
        """
        if len(self._peers) <= self._most:
            return False
        staying = [peer for peer in self._peers.values() if peer.leaves_at is None]
        idle: dict[str, deque[_Peer]] = defaultdict(deque)  # by network, oldest first
        for peer in staying:
            if not peer.has_session:
                idle[peer.network].append(peer)
        num_excess = len(staying) - self._most
        for _ in range(num_excess):
            largest = max(idle.values(), key=len, default=None)
            if not largest:
                break
            self._end(largest.popleft(), _TOO_MANY)
        if len(self._peers) > self._most + _SPARE:
            for descriptor, peer in self._peers.items():
                if peer.leaves_at is not None:
                    self._shut(descriptor, peer)
        return num_excess > 0

    def _end(self, peer: _Peer, reason: str) -> None:
        """Sends the reason to a client and schedules the shutdown of its connection."""
        peer.leaves_at = time.monotonic()
        if peer.identity:
            peer.leaves_at += _FAREWELL
            self._refuse(peer.identity, reason)

    def _unread(self, descriptor: int, peer: _Peer) -> int:
        """Returns by how much a connection exceeds its data limit [bytes]; 0 if unknown."""
        try:
            with self._window.onto(descriptor) as connection:
                received = bytes_received(connection)
        except OSError:  # the connection is closed
            return 0
        peer.num_read = min(peer.num_read, received)  # the overhead of its messages is an estimate
        limit = MAX_UNREAD if peer.has_session else _MAX_UNREAD_IDLE
        return max(0, received - peer.num_read - limit)

    def _shut(self, descriptor: int, peer: _Peer) -> None:
        """Shuts a connection down, unless its descriptor now belongs to another one."""
        with suppress(OSError), self._window.onto(descriptor) as connection:
            if (connection.getsockname(), connection.getpeername()) == peer.ends:
                connection.shutdown(socket.SHUT_RDWR)
