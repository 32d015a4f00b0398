"""Accepts connections to the page and enforces limits on them."""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from collections.abc import Callable
from contextlib import suppress

from stkzoo._os import max_descriptors, network_of

#: Maximum numbers of visitors (connections without a viewer), viewers, and viewers per network.
MOST_VISITORS, MOST_VIEWERS, MOST_VIEWERS_OF_ONE = 64, 64, 32
#: Visitors and viewers may each use 1/16 of the process's file descriptors; the race needs the
#: others.
_SHARE = 16
_LEAST = 8
#: Time after which a visitor's connection is closed [s].
_LIFETIME = 10.0
#: Pause after each connection, so that a flood of them does not slow the race, and pause when no
#: file descriptors are left [s].
_PAUSE, _LONG_PAUSE = 0.001, 0.1


class ConnectionGate:
    """Accepts connections one by one and closes those that take too long.

    A connection belongs to a visitor until :meth:`promote` makes it a viewer's. At the limit, each
    new visitor replaces the oldest visitor of the network with the most visitors. A client that
    sends its request immediately therefore gets a response, even if many others hold connections
    open.

    Args:
        listener: listening socket.
    """

    def __init__(self, listener: socket.socket) -> None:
        self._listener = listener
        listener.setblocking(False)
        share = max(_LEAST, max_descriptors() // _SHARE)
        self._most_visitors = min(MOST_VISITORS, share)
        self._most_viewers = min(MOST_VIEWERS, share)
        self._visitors: dict[asyncio.BaseTransport, str] = {}  # with their networks, oldest first
        self._viewers: dict[asyncio.BaseTransport, str] = {}

    async def run(self, make_protocol: Callable[[], asyncio.Protocol]) -> None:
        """Accepts connections until the task is canceled.

        Args:
            make_protocol: creates the protocol of each connection.
        """
        loop = asyncio.get_running_loop()
        while True:
            try:
                connection, _ = await loop.sock_accept(self._listener)
            except OSError:  # no file descriptors are left
                await asyncio.sleep(_LONG_PAUSE)
                continue
            self._make_room()
            with suppress(OSError):  # the connection is already closed
                await self._admit(connection, make_protocol)
            await asyncio.sleep(_PAUSE)

    def promote(self, transport: asyncio.BaseTransport) -> str:
        """Makes a visitor a viewer.

        Returns:
            The reason for a refusal; an empty string if the visitor is now a viewer.
        """
        self._viewers = _open_ones(self._viewers)
        network = self._visitors.get(transport)
        if network is None:
            return "the connection is closed"
        if len(self._viewers) >= self._most_viewers:
            return f"{self._most_viewers} viewers are connected already"
        if Counter(self._viewers.values())[network] >= MOST_VIEWERS_OF_ONE:
            return f"{MOST_VIEWERS_OF_ONE} viewers of your network are connected already"
        self._viewers[transport] = self._visitors.pop(transport)
        return ""

    def demote(self, transport: asyncio.BaseTransport) -> None:
        """Makes a leaving viewer a visitor, so that its connection is closed in bounded time."""
        network = self._viewers.pop(transport, None)
        if network is not None:
            self._add(transport, network)

    async def _admit(
        self, connection: socket.socket, make_protocol: Callable[[], asyncio.Protocol]
    ) -> None:
        try:
            network = network_of(connection.getpeername()[0])
            loop = asyncio.get_running_loop()
            transport, _ = await loop.connect_accepted_socket(make_protocol, connection)
        except BaseException:
            connection.close()
            raise
        self._add(transport, network)

    def _add(self, transport: asyncio.BaseTransport, network: str) -> None:
        self._visitors[transport] = network
        asyncio.get_running_loop().call_later(_LIFETIME, self._expire, transport)

    def _make_room(self) -> None:
        self._visitors = _open_ones(self._visitors)
        if len(self._visitors) >= self._most_visitors:
            (largest, _), *_ = Counter(self._visitors.values()).most_common(1)
            self._expire(next(one for one, network in self._visitors.items() if network == largest))

    def _expire(self, transport: asyncio.BaseTransport) -> None:
        """Aborts a visitor's connection, even if its response has not been read."""
        if self._visitors.pop(transport, None) is not None:
            assert isinstance(transport, asyncio.WriteTransport)  # noqa: S101 - of a stream socket
            transport.abort()


def _open_ones(
    transports: dict[asyncio.BaseTransport, str],
) -> dict[asyncio.BaseTransport, str]:
    """Returns the transports whose sockets are still open."""
    return {
        transport: network
        for transport, network in transports.items()
        if transport.get_extra_info("socket").fileno() >= 0
    }
