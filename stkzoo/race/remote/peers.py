"""The connections of a server: how many there are, and which of them must end."""

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

from stkzoo._os import max_descriptors, network_of
from stkzoo.race.remote.sockets import zmq_module

#: Connections take at most this part of the process's descriptors; agents need the rest.
_SHARE = 4
_MOST, _LEAST = 1024, 16
#: So many more connections may wait for their last message to be sent.
_SPARE = 32
#: A connection without a session ends after this time [s], ...
IDLE = 30.0
#: ... and a connection that has sent so much more than the server could read [bytes].
_MAX_UNREAD, _MAX_UNREAD_IDLE = 96 << 20, 16 << 20
#: How long a connection that ends may take to receive its last message [s].
_FAREWELL = 0.2
#: Where Linux has the number of bytes received in ``struct tcp_info``.
_BYTES_RECEIVED = struct.Struct("@128xQ")

_TOO_MANY = "the server has too many connections, and this one has no race; try again later"
_IDLE_TOO_LONG = f"the connection had no race for {IDLE:g} s; connect again when a race starts"
_TOO_MUCH = "the connection sent more than the server can read"


@dataclass(slots=True)
class _Peer:
    """One connection.

    Attributes:
        ends: its two addresses, which say whether a descriptor is still this connection's.
        network: whom it counts for.
        since: when it came, or its session ended.
        identity: ZeroMQ's name for it; empty until it has said something.
        num_read: bytes of its messages that its session received; ``None`` without a session.
        leaves_at: when it is cut; ``None`` as long as it may stay.
    """

    ends: tuple[Any, Any]
    network: str
    since: float
    identity: bytes = b""
    num_read: int | None = None
    leaves_at: float | None = None


class _Window:
    """Looks at connections by their descriptors. It needs no new one: there may be none left."""

    def __init__(self) -> None:
        self._null = os.open(os.devnull, os.O_RDONLY)
        self._own = os.dup(self._null)

    @contextmanager
    def onto(self, descriptor: int) -> Iterator[socket.socket]:
        """The connection behind a descriptor now, whatever ZeroMQ does with the descriptor.

        Raises:
            OSError: there is no connection any more.
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
        """Frees its descriptors."""
        os.close(self._own)
        os.close(self._null)


class PeerTable:
    """Follows the connections of a ROUTER socket, and ends idle ones before they are too many.

    ZeroMQ accepts connections until the process has no descriptors left, and has no call that
    ends one. This table learns of each connection from ZeroMQ's events, and shuts its descriptor
    down. At the limit, a new connection replaces the oldest one without a session of the address
    that has most of them.

    Args:
        router: the socket.
        refuse: sends a reason to a client, by its identity.
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
        """Stops following; call it before the router is closed."""
        self._router.disable_monitor()
        self.socket.close(0)
        self._window.close()

    def update(self) -> bool:
        """Handles events, up to a number; returns whether connections had to end."""
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
        """Notes which connection a client's message came from."""
        try:
            peer = self._peers.get(int(frame.get("__fd")))
        except (self._zmq.ZMQError, ValueError):  # a transport without descriptors
            return
        if peer is not None:
            peer.identity = identity
            self._by_identity[identity] = peer

    def begin_session(self, identity: bytes) -> None:
        """Notes that a client has a session."""
        if (peer := self._by_identity.get(identity)) is not None:
            peer.num_read = 0

    def count(self, identity: bytes, size: int) -> None:
        """Notes that a session received a message."""
        peer = self._by_identity.get(identity)
        if peer is not None and peer.num_read is not None:
            peer.num_read += size

    def end_session(self, identity: bytes) -> None:
        """Notes that a client's session is over."""
        if (peer := self._by_identity.get(identity)) is not None:
            peer.num_read, peer.since = None, time.monotonic()

    def check(self) -> None:
        """Ends connections that are idle for too long, or send more than is read."""
        now = time.monotonic()
        for descriptor, peer in list(self._peers.items()):
            if peer.leaves_at is not None:
                if now >= peer.leaves_at:
                    self._shut(descriptor, peer)
            elif peer.num_read is None and now - peer.since > IDLE:
                self._end(peer, _IDLE_TOO_LONG)
            elif self._unread(descriptor, peer) > 0:
                self._shut(descriptor, peer)

    def _add(self, descriptor: int) -> None:
        try:
            with self._window.onto(descriptor) as connection:
                ends = connection.getsockname(), connection.getpeername()
        except OSError:  # it is gone already
            return
        host = ends[1][0] if isinstance(ends[1], tuple) else ""
        self._peers[descriptor] = _Peer(ends, network_of(host), time.monotonic())

    def _forget(self, descriptor: int) -> None:
        peer = self._peers.pop(descriptor, None)
        if peer is not None and self._by_identity.get(peer.identity) is peer:
            del self._by_identity[peer.identity]

    def _make_room(self) -> bool:
        """Ends connections without a session until few enough stay."""
        if len(self._peers) <= self._most:
            return False
        staying = [peer for peer in self._peers.values() if peer.leaves_at is None]
        idle: dict[str, deque[_Peer]] = defaultdict(deque)  # by network, oldest first
        for peer in staying:
            if peer.num_read is None:
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
        """Ends a connection once it has its last message."""
        peer.leaves_at = time.monotonic()
        if peer.identity:
            peer.leaves_at += _FAREWELL
            self._refuse(peer.identity, reason)

    def _unread(self, descriptor: int, peer: _Peer) -> int:
        """How much more a connection has sent than it may; 0 where the system does not say."""
        if not hasattr(socket, "TCP_INFO"):
            return 0
        try:
            with self._window.onto(descriptor) as connection:
                info = connection.getsockopt(
                    socket.IPPROTO_TCP, socket.TCP_INFO, _BYTES_RECEIVED.size
                )
                received: int = _BYTES_RECEIVED.unpack(info)[0]
        except (OSError, struct.error):  # it is gone, or no TCP
            return 0
        limit = _MAX_UNREAD_IDLE if peer.num_read is None else peer.num_read + _MAX_UNREAD
        return max(0, received - limit)

    def _shut(self, descriptor: int, peer: _Peer) -> None:
        """Cuts a connection, unless its descriptor is another one's by now."""
        with suppress(OSError), self._window.onto(descriptor) as connection:
            if (connection.getsockname(), connection.getpeername()) == peer.ends:
                connection.shutdown(socket.SHUT_RDWR)
