"""Web server of the page, which runs in its own thread."""

from __future__ import annotations

import asyncio
import hmac
import logging
import re
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from aiohttp import web
from multidict import MultiMapping

from stkzoo._logs import RepeatFilter
from stkzoo._os import ip_address_of, is_loopback, max_descriptors
from stkzoo.errors import ConfigError, reason
from stkzoo.race.web.control import RaceControl
from stkzoo.race.web.messages import RaceNews
from stkzoo.race.web.viewer import PROTOCOL_VERSION, Viewer

logger = logging.getLogger(__name__)
#: Logger for aiohttp, which logs a traceback for each invalid request.
_requests_logger = logging.getLogger(f"{__name__}.requests")
_requests_logger.addFilter(RepeatFilter(most=1, period=60.0))

_FILES = Path(__file__).parent / "static"
#: Content types by suffix. Those of :mod:`mimetypes` depend on the machine.
_CONTENT_TYPES = {
    ".css": "text/css",
    ".html": "text/html",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
}
_LONGEST_MESSAGE = 1024
_HEARTBEAT = 20.0
#: Maximum line length of a request [bytes], and time limit for reading the rest of a request after
#: the response [s].
_LONGEST_LINE, _LINGERING = 4096, 1.0
#: Time limits for viewers to receive the last messages, and for the thread to end [s].
_FAREWELL, _END = 2.0, 10.0
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}

#: Maximum numbers of visitors (connections without a viewer) and of viewers. Each may use 1/16 of
#: the process's file descriptors; the race needs the others.
_MOST, _LEAST, _SHARE = 64, 8, 16
#: Time after which a visitor's connection is closed [s].
_LIFETIME = 10.0
#: Pause after each connection, so that a flood of them does not slow the race, and pause when no
#: file descriptors are left [s].
_PAUSE, _LONG_PAUSE = 0.001, 0.1

#: A host and its port in a URL or a ``Host`` header.
_AUTHORITY = re.compile(r"(?P<name>\[[0-9a-f:.]+\]|[a-z0-9._-]+)(:[0-9]{1,5})?")
_Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class RequestGuard:
    """Decides which requests may watch a race and which may control it.

    If the user's browser shows a page of another site, that page can send requests to this machine.
    Two headers, which the browser sets and the page cannot change, identify such requests.
    ``Origin`` names the other site. ``Host`` names the other site's domain if that domain resolves
    to this machine (DNS rebinding).

    Args:
        host: name or address on which the page is served.
        port: port on which the page is served.

    Attributes:
        key: key for control; empty on a loopback address, where each viewer may control the race.
    """

    def __init__(self, host: str, port: int) -> None:
        self._host = host.lower()
        self.key = "" if is_loopback(host) else _key_of(self._host, port)

    def check(self, headers: MultiMapping[str]) -> None:
        """Rejects requests that do not come from this page.

        Raises:
            HTTPForbidden: ``Host`` is neither an IP address nor ``localhost`` nor the page's name,
                or ``Origin`` is another site.
        """
        host = ",".join(headers.getall("Host", []))  # two headers are no host
        origin = ",".join(headers.getall("Origin", ["none"]))
        match = _AUTHORITY.fullmatch(host.lower())
        name = match["name"].strip("[]") if match else ""
        is_ours = name in ("localhost", self._host) or ip_address_of(name) is not None
        if not name or not is_ours:
            raise web.HTTPForbidden(text="unknown host name; open the page by its IP address\n")
        # Other programs than browsers send no Origin, and could forge it.
        if origin != "none" and origin.lower() != f"http://{host.lower()}":
            raise web.HTTPForbidden(text="the page accepts requests from itself only\n")

    def may_steer(self, key: str) -> bool:
        """Returns whether a viewer with this key may control the race."""
        return hmac.compare_digest(key.encode(), self.key.encode()) or not self.key


@cache
def _key_of(host: str, port: int) -> str:  # noqa: ARG001 - the cache key
    """Returns a random key. The pages of a program's next races on the port have the same key.

    An open page reconnects to the next race with the key that it has.
    """
    return secrets.token_urlsafe(16)


class LiveServer:
    """The web server with the page and its viewers. It starts when the object is created.

    It accepts connections one by one. A connection belongs to a visitor, unless a viewer has it. At
    the limit, each new visitor replaces the oldest one.

    Attributes:
        news: content of the page; the race's thread replaces it.
        most: maximum number of visitors, and of viewers.
        viewers: connections of the viewers.
        port: port that the server listens on.
        url: address of the page, including the key for control if one is required.

    Args:
        host: address or name to listen on.
        port: port to listen on; 0 selects a free port.
        control: control of the race.

    Raises:
        ConfigError: the address or port is not available.
    """

    def __init__(self, host: str, port: int, control: RaceControl) -> None:
        self.news = RaceNews()
        self._control = control
        self._pages = {f"/{file.name}": _page_of(file) for file in _FILES.iterdir()}
        self._pages["/"] = self._pages["/index.html"]
        self._listener = _listener(host, port)
        self.most = min(_MOST, max(_LEAST, max_descriptors() // _SHARE))
        self.viewers: set[asyncio.WriteTransport] = set()
        self.port: int = self._listener.getsockname()[1]
        self._guard = RequestGuard(host, self.port)
        address, key = _shown(host, self._listener), self._guard.key
        shown = f"[{address}]" if ":" in address else address
        self.url = f"http://{shown}:{self.port}/{key and f'#key={key}'}"
        self._loop, self._closing = asyncio.new_event_loop(), asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="stkzoo-live-page", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Sends the last messages to viewers, then stops; may be called more than once."""
        if not self._thread.is_alive():
            return
        with suppress(RuntimeError):  # the loop has ended in the meantime
            self._loop.call_soon_threadsafe(self._closing.set)
        self._thread.join(_END)
        if self._thread.is_alive():
            logger.warning("the live page did not close in %.0f s", _END)

    # ------------------------------------------------------------------ the thread

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._listener.close()
            self._loop.close()

    async def _serve(self) -> None:
        app = web.Application(middlewares=[self._guarded])
        app.router.add_get("/live", self._live)
        app.router.add_get("/{name:[^/]*}", self._page)
        runner = web.AppRunner(
            app,
            access_log=None,
            logger=_requests_logger,
            shutdown_timeout=1.0,
            max_line_size=_LONGEST_LINE,
            max_field_size=_LONGEST_LINE,
            lingering_time=_LINGERING,
        )
        await runner.setup()
        assert runner.server is not None  # noqa: S101 - since setup
        accepting = asyncio.ensure_future(self._accept(runner.server))
        try:
            await self._closing.wait()
            deadline = self._loop.time() + _FAREWELL
            while self.viewers and self._loop.time() < deadline:
                await asyncio.sleep(0.02)
        finally:
            accepting.cancel()
            await asyncio.gather(accepting, return_exceptions=True)
            await runner.cleanup()

    async def _accept(self, server: web.Server) -> None:
        """Accepts connections until the task is canceled."""
        while True:
            try:
                connection, _ = await self._loop.sock_accept(self._listener)
            except OSError:  # no file descriptors are left
                await asyncio.sleep(_LONG_PAUSE)
                continue
            transports = [handler.transport for handler in server.connections]  # oldest first
            visitors = [one for one in transports if one not in self.viewers]
            if len(visitors) >= self.most:
                self._expire(visitors[0])
            with suppress(OSError):  # the connection is already closed
                transport, _ = await self._loop.connect_accepted_socket(server, connection)
                self._loop.call_later(_LIFETIME, self._expire, transport)
            await asyncio.sleep(_PAUSE)

    def _expire(self, transport: Any) -> None:
        """Aborts a visitor's connection, even if its response has not been read."""
        if transport is not None and transport not in self.viewers:
            transport.abort()

    # ------------------------------------------------------------------ requests

    @web.middleware
    async def _guarded(self, request: web.Request, handler: _Handler) -> web.StreamResponse:
        try:
            self._guard.check(request.headers)
            response = await handler(request)
        except web.HTTPException as error:
            error.force_close()
            raise
        response.force_close()  # one request per connection, so that _accept limits the rate
        return response

    async def _page(self, request: web.Request) -> web.StreamResponse:
        page = self._pages.get(request.path)
        if page is None:
            raise web.HTTPNotFound(text="this page does not exist; the race is at /\n")
        body, content_type = page
        return web.Response(body=body, content_type=content_type, charset="utf-8", headers=_HEADERS)

    async def _live(self, request: web.Request) -> web.StreamResponse:
        if request.query.get("version") != str(PROTOCOL_VERSION):
            raise web.HTTPBadRequest(text=f"expected ?version={PROTOCOL_VERSION}; reload /\n")
        connection = web.WebSocketResponse(
            max_msg_size=_LONGEST_MESSAGE,
            heartbeat=_HEARTBEAT,
            compress=False,
            timeout=1.0,
            autoping=False,  # pings count as messages from the viewer
        )
        if not connection.can_prepare(request):
            raise web.HTTPBadRequest(text="this address is for WebSockets; the race is at /\n")
        transport = request.transport
        assert isinstance(transport, asyncio.WriteTransport)  # noqa: S101 - of a stream socket
        if len(self.viewers) >= self.most:
            reason = f"{self.most} viewers are connected already; try again later\n"
            raise web.HTTPServiceUnavailable(text=reason)
        self.viewers.add(transport)
        try:
            await connection.prepare(request)
            may_steer = self._guard.may_steer(request.query.get("key", ""))
            viewer = Viewer(
                connection, lambda: self.news, self._control, self._closing, may_steer=may_steer
            )
            await viewer.serve()
        finally:
            self.viewers.discard(transport)
            self._loop.call_later(_LIFETIME, self._expire, transport)
        return connection


def _page_of(file: Path) -> tuple[bytes, str]:
    """Returns a file's content and type.

    Files are read before the race, because no file descriptors may be left during it.
    """
    return file.read_bytes(), _CONTENT_TYPES.get(file.suffix, "application/octet-stream")


def _listener(host: str, port: int) -> socket.socket:
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.create_server(address[:2], family=family)
    except (OSError, OverflowError) as error:
        raise ConfigError(
            f"the live page cannot use {host}, port {port}: {reason(error)}; choose another "
            "port (0 takes a free one), or end the program that uses it"
        ) from error
    listener.setblocking(False)
    return listener


def _shown(host: str, listener: socket.socket) -> str:
    """Returns the address to open in a browser; for a wildcard address, this machine's address."""
    address = ip_address_of(listener.getsockname()[0])
    if address is not None and address.is_unspecified:
        beyond = "2001:db8::1" if address.version == 6 else "192.0.2.1"
        with suppress(OSError), socket.socket(listener.family, socket.SOCK_DGRAM) as way:
            way.connect((beyond, 9))  # only looks up the route; sends nothing
            return str(way.getsockname()[0])
    return host
