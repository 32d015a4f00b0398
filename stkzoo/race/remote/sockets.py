"""ZeroMQ sockets with the limits and keys of networked races."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Collection
from dataclasses import dataclass, field
from types import ModuleType
from typing import TYPE_CHECKING, Any

from stkzoo.errors import ConfigError, RemoteError
from stkzoo.race.remote.protocol import LIMITS

if TYPE_CHECKING:
    import zmq

    from stkzoo.race.remote.keys import KeyPair

#: Default address of a server.
DEFAULT_ADDRESS = "tcp://127.0.0.1:5555"

_DEFAULT_PORT = "5555"
_TCP = re.compile(r"(?P<host>\[[0-9a-fA-F:.%]+\]|[A-Za-z0-9_.-]+|\*)(:(?P<port>\d{1,5}|\*))?")


def zmq_module() -> ModuleType:
    """The module ``zmq``.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        import zmq
    except ImportError as error:
        raise ConfigError(
            "networked races need pyzmq, which is not installed: pip install 'stkzoo[remote]'"
        ) from error
    return zmq


def full_address(text: str) -> str:
    """An address in ZeroMQ's form.

    Args:
        text: ``tcp://host:port``, ``host:port``, ``host`` or ``ipc:///path``. A server's host
            may be ``*`` for all of the machine's, and its port ``*`` for any free one.

    Raises:
        ConfigError: it is none of these.
    """
    if text.startswith("ipc://") and len(text) > len("ipc://"):
        return text
    match = _TCP.fullmatch(text.removeprefix("tcp://"))
    if match is None or not _is_port(match["port"] or _DEFAULT_PORT):
        raise ConfigError(f"address {text!r}, expected one such as {DEFAULT_ADDRESS}")
    host = "127.0.0.1" if match["host"] == "localhost" else match["host"]
    return f"tcp://{host}:{match['port'] or _DEFAULT_PORT}"


def _is_port(text: str) -> bool:
    return text == "*" or 0 < int(text) < 65536


def is_local(address: str) -> bool:
    """Whether only programs on the same machine can reach an address."""
    if address.startswith("ipc://"):
        return True
    host = address.removeprefix("tcp://").rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


#: Interval of heartbeats, and the silence after which a connection is dead [ms].
_HEARTBEAT, _DEAD = 1000, 4000
#: Time limit for a client to prove its keys [ms].
_HANDSHAKE = 5000
#: Queue length on either side of one connection [messages].
_QUEUE = 16
_DOMAIN = b"stkzoo"


@dataclass(frozen=True, slots=True)
class ServerKeys:
    """A server's own keys, and those of its clients.

    Attributes:
        own: its keys; ``None`` for no encryption.
        allowed: public keys of its clients; ``None`` for all clients.
    """

    own: KeyPair | None = None
    allowed: Collection[str] | None = field(default=None)

    def check(self, address: str, insecure: bool) -> None:
        """Rejects an address that other machines can reach without keys.

        Raises:
            ConfigError: they can, and ``insecure`` is not set.
        """
        if self.allowed is not None and self.own is None:
            raise ConfigError("allowed clients have no effect without the server's secret key")
        is_closed = self.own is not None and self.allowed is not None
        if not (is_local(address) or is_closed or insecure):
            raise ConfigError(
                f"other machines can reach {address}; give the server a key of its own (--secret) "
                "and those of its clients (--allow), or use --insecure"
            )


def server_socket(context: zmq.Context[Any], address: str, keys: ServerKeys) -> zmq.Socket[Any]:
    """A ROUTER socket that listens.

    Raises:
        ConfigError: the address is not available.
    """
    lib = zmq_module()
    socket: zmq.Socket[Any] = context.socket(lib.ROUTER)
    _set_limits(socket, address)
    socket.setsockopt(lib.ROUTER_MANDATORY, 1)
    socket.setsockopt(lib.HANDSHAKE_IVL, _HANDSHAKE)
    if keys.own is not None:
        socket.setsockopt(lib.ZAP_DOMAIN, _DOMAIN)
        socket.setsockopt(lib.CURVE_SERVER, 1)
        socket.setsockopt(lib.CURVE_SECRETKEY, keys.own.secret.encode())
    try:
        socket.bind(address)
    except lib.ZMQError as error:
        socket.close(0)
        raise ConfigError(f"cannot listen on {address}: {error}") from error
    return socket


def client_socket(
    context: zmq.Context[Any], address: str, keys: KeyPair | None, server_key: str | None
) -> zmq.Socket[Any]:
    """A DEALER socket that connects by itself.

    Args:
        context: ZeroMQ's.
        address: the server's.
        keys: the client's own; needed with ``server_key``.
        server_key: the server's public key; ``None`` for no encryption.

    Raises:
        RemoteError: the address cannot be connected to.
    """
    lib = zmq_module()
    socket: zmq.Socket[Any] = context.socket(lib.DEALER)
    _set_limits(socket, address)
    socket.setsockopt(lib.RECONNECT_IVL, 50)
    socket.setsockopt(lib.RECONNECT_IVL_MAX, 500)
    if server_key is not None:
        assert keys is not None  # noqa: S101 - RemoteDriverGroup makes them
        socket.setsockopt(lib.CURVE_SERVERKEY, server_key.encode())
        socket.setsockopt(lib.CURVE_PUBLICKEY, keys.public.encode())
        socket.setsockopt(lib.CURVE_SECRETKEY, keys.secret.encode())
    try:
        socket.connect(address)
    except lib.ZMQError as error:
        socket.close(0)
        raise RemoteError(f"cannot connect to {address}: {error}") from error
    return socket


def _set_limits(socket: zmq.Socket[Any], address: str) -> None:
    zmq = zmq_module()
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.MAXMSGSIZE, LIMITS.max_bytes)
    socket.setsockopt(zmq.RCVHWM, _QUEUE)
    socket.setsockopt(zmq.SNDHWM, _QUEUE * 4)
    socket.setsockopt(zmq.HEARTBEAT_IVL, _HEARTBEAT)
    socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, _DEAD)
    socket.setsockopt(zmq.HEARTBEAT_TTL, _DEAD)
    if "[" in address:
        socket.setsockopt(zmq.IPV6, 1)


class ClientAuthenticator:
    """Answers ZeroMQ's requests to authenticate clients by their keys (ZAP, RFC 27).

    Args:
        context: the server's.
        allowed: the clients' public keys; ``None`` allows all clients.
    """

    def __init__(self, context: zmq.Context[Any], allowed: Collection[str] | None) -> None:
        zmq = zmq_module()
        from zmq.utils import z85

        self._allowed = None if allowed is None else frozenset(allowed)
        self._encode = z85.encode
        self.socket = context.socket(zmq.REP)
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.bind("inproc://zeromq.zap.01")

    def answer(self) -> bool:
        """Answers one request; returns whether the client is allowed."""
        version, request, domain, _, _, mechanism, *credentials = self.socket.recv_multipart()
        is_ours = version == b"1.0" and domain == _DOMAIN and mechanism == b"CURVE"
        key = self._encode(credentials[0]).decode() if is_ours and credentials else ""
        is_allowed = bool(key) and (self._allowed is None or key in self._allowed)
        status = [b"200", b"OK"] if is_allowed else [b"400", b"this key is not on the list"]
        self.socket.send_multipart(
            [version, request, *status, key.encode() if is_allowed else b"", b""]
        )
        return is_allowed
