"""Accepts connections to the page and enforces limits on them."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress

from stkzoo._os import max_descriptors

#: Maximum numbers of visitors (connections without a viewer) and of viewers. Each may use 1/16 of
#: the process's file descriptors; the race needs the others.
_MOST, _LEAST, _SHARE = 64, 8, 16
#: Time after which a visitor's connection is closed [s].
_LIFETIME = 10.0
#: Pause after each connection, so that a flood of them does not slow the race, and pause when no
#: file descriptors are left [s].
_PAUSE, _LONG_PAUSE = 0.001, 0.1


class ConnectionGate:
    """Accepts connections one by one and closes those that take too long.

    A connection belongs to a visitor until :meth:`promote` makes it a viewer's. At the limit, each
    new visitor replaces the oldest one.

    Args:
        listener: listening socket.

    Attributes:
        most: maximum number of visitors, and of viewers.
    """

    def __init__(self, listener: socket.socket) -> None:
        self._listener = listener
        listener.setblocking(False)
        self.most = min(_MOST, max(_LEAST, max_descriptors() // _SHARE))
        self._visitors: dict[asyncio.WriteTransport, None] = {}  # oldest first
        self._viewers: set[asyncio.BaseTransport] = set()

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
            if len(self._visitors) >= self.most:
                self._expire(next(iter(self._visitors)))
            with suppress(OSError):  # the connection is already closed
                transport, _ = await loop.connect_accepted_socket(make_protocol, connection)
                self._add(transport)
            await asyncio.sleep(_PAUSE)

    def promote(self, transport: asyncio.WriteTransport) -> bool:
        """Makes a visitor a viewer and returns whether there was room for one."""
        if len(self._viewers) >= self.most or transport not in self._visitors:
            return False
        del self._visitors[transport]
        self._viewers.add(transport)
        return True

    def demote(self, transport: asyncio.WriteTransport) -> None:
        """Makes a leaving viewer a visitor, so that its connection is closed in bounded time."""
        self._viewers.discard(transport)
        self._add(transport)

    def _add(self, transport: asyncio.WriteTransport) -> None:
        self._visitors[transport] = None
        asyncio.get_running_loop().call_later(_LIFETIME, self._expire, transport)

    def _expire(self, transport: asyncio.WriteTransport) -> None:
        """Aborts a visitor's connection, even if its response has not been read."""
        if transport in self._visitors:
            del self._visitors[transport]
            transport.abort()
