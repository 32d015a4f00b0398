"""Accepts connections to the page, within limits that no client can exceed."""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from collections.abc import Callable
from contextlib import suppress

from stkzoo._os import max_descriptors, network_of

#: Connections without a viewer, viewers, and viewers from one network; each at most.
MOST_VISITORS, MOST_VIEWERS, MOST_VIEWERS_OF_ONE = 64, 64, 32
#: Each of the first two may take this part of the process's descriptors; the race needs the rest.
_SHARE = 16
_LEAST = 8
#: A connection ends after this time, unless it becomes a viewer's [s].
_LIFETIME = 10.0
#: Wait after each connection, so that a flood leaves the processor to the race; and without
#: descriptors [s].
_PAUSE, _LONG_PAUSE = 0.001, 0.1


class ConnectionGate:
    """Accepts connections one by one and ends those that take too long.

    A connection is a visitor's until :meth:`promote` makes it a viewer's. At the limit, each new
    visitor replaces the oldest one of the network that has the most visitors. So a client that
    sends its request at once gets its answer, however many others only hold their connections.

    Args:
        listener: a socket that listens.
    """

    def __init__(self, listener: socket.socket) -> None:
        self._listener = listener
        listener.setblocking(False)
        share = max(_LEAST, max_descriptors() // _SHARE)
        self._most_visitors = min(MOST_VISITORS, share)
        self._most_viewers = min(MOST_VIEWERS, share)
        self._visitors: dict[asyncio.BaseTransport, str] = {}  # networks, oldest first
        self._viewers: dict[asyncio.BaseTransport, str] = {}

    async def run(self, make_protocol: Callable[[], asyncio.Protocol]) -> None:
        """Accepts connections until it is cancelled.

        Args:
            make_protocol: makes the protocol of each connection.
        """
        loop = asyncio.get_running_loop()
        while True:
            try:
                connection, _ = await loop.sock_accept(self._listener)
            except OSError:  # there are no descriptors left
                await asyncio.sleep(_LONG_PAUSE)
                continue
            self._make_room()
            with suppress(OSError):  # it is gone already
                await self._admit(connection, make_protocol)
            await asyncio.sleep(_PAUSE)

    def promote(self, transport: asyncio.BaseTransport) -> str:
        """Makes a visitor a viewer.

        Returns:
            Why it cannot be one; empty if it is one now.
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
        """Makes a viewer that leaves a visitor, whose connection ends soon in any case."""
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
        """Ends a visitor's connection, also one whose answer nobody reads."""
        if self._visitors.pop(transport, None) is not None:
            assert isinstance(transport, asyncio.WriteTransport)  # noqa: S101 - a stream socket's
            transport.abort()


def _open_ones(
    transports: dict[asyncio.BaseTransport, str],
) -> dict[asyncio.BaseTransport, str]:
    """Those that still have a descriptor."""
    return {
        transport: network
        for transport, network in transports.items()
        if transport.get_extra_info("socket").fileno() >= 0
    }
