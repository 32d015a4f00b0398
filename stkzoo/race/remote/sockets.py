"""ZeroMQ sockets with the limits and keys of networked races, and the files of keys.

``NAME.secret`` contains both the secret and the public key; its owner must not share it.
``NAME.public`` contains the public key for others. Each line is a word and a key in ZeroMQ's Z85
encoding, so you can concatenate public files.
"""

from __future__ import annotations

import logging
import os
import re
import socket
from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stkzoo._imports import import_extra
from stkzoo._logs import RepeatFilter
from stkzoo._os import is_loopback, max_descriptors, write_whole
from stkzoo._reading import read_text, reading
from stkzoo.drivers.messages import MAX_BYTES
from stkzoo.errors import ConfigError, RemoteError

logger = logging.getLogger(__name__)
logger.addFilter(RepeatFilter())

if TYPE_CHECKING:
    import zmq

#: Default address of a server.
DEFAULT_ADDRESS = "tcp://127.0.0.1:5555"

_DEFAULT_PORT = "5555"
_TCP = re.compile(r"(?P<host>\[[0-9a-fA-F:.%]+\]|[A-Za-z0-9_.-]+|\*)(:(?P<port>\d{1,5}|\*))?")


def zmq_module() -> Any:
    """Returns the module ``zmq``.

    Raises:
        ConfigError: pyzmq is not installed.
    """
    return import_extra("zmq", "networked races need", "races")


def full_address(text: str) -> str:
    """Converts an address to ZeroMQ's format.

    Args:
        text: ``tcp://host:port``, ``host:port`` or ``host``. The default port is 5555. A server's
            host may be ``*`` for all network interfaces, and its port may be ``*`` for any free
            port.

    Raises:
        ConfigError: the text has none of these forms.
    """
    match = _TCP.fullmatch(text.removeprefix("tcp://"))
    port = (match and match["port"]) or _DEFAULT_PORT
    if match is None or not (port == "*" or 0 < int(port) < 65536):
        raise ConfigError(f"address {text!r}, expected one such as {DEFAULT_ADDRESS}")
    host = "127.0.0.1" if match["host"] == "localhost" else match["host"]
    return f"tcp://{host}:{port}"


def is_local(address: str) -> bool:
    """Returns whether only programs on the same machine can reach an address."""
    host = address.removeprefix("tcp://").rpartition(":")[0].strip("[]")
    return is_loopback(host)


#: Options of all sockets; times in ms, lengths of a connection's queues in messages. A connection
#: without messages and heartbeats for ``HEARTBEAT_TIMEOUT`` is closed. The send queue has room for
#: the replies to the opening of all seats.
_LIMITS = {
    "LINGER": 0,
    "MAXMSGSIZE": MAX_BYTES,
    "RCVHWM": 4,
    "SNDHWM": 100,
    "HEARTBEAT_IVL": 1000,
    "HEARTBEAT_TIMEOUT": 4000,
    "HEARTBEAT_TTL": 4000,
}
#: Time limit for the handshake, in which a client proves that it has its keys [ms].
_HANDSHAKE = 5000
_DOMAIN = b"stkzoo"
#: Connections use at most 1/4 of the process's file descriptors; agents need the others.
_SHARE = 4
_MOST, _LEAST = 1024, 16


@dataclass(frozen=True, slots=True)
class ServerKeys:
    """Keys of a server and of its clients.

    Attributes:
        pair: the server's keys; ``None`` for no encryption.
        allowed: public keys of the allowed clients; ``None`` to allow all clients.
    """

    pair: KeyPair | None = None
    allowed: Collection[str] | None = field(default=None)

    def check(self, address: str, insecure: bool) -> None:
        """Rejects an address that other machines can reach without keys.

        Raises:
            ConfigError: other machines can reach the address without keys and ``insecure`` is not
                set, or there are allowed clients but no server keys.
        """
        if self.allowed is not None and self.pair is None:
            raise ConfigError(
                "allowed clients (--allow) have no effect without the server's secret key; add "
                "--secret, or leave them out"
            )
        is_closed = self.pair is not None and self.allowed is not None
        if not (is_local(address) or is_closed or insecure):
            raise ConfigError(
                f"other machines can reach {address}; give the server a key of its own (--secret) "
                "and those of its clients (--allow), or use --insecure"
            )


def server_socket(context: zmq.Context[Any], address: str, keys: ServerKeys) -> zmq.Socket[Any]:
    """Returns a ROUTER socket that listens on an address.

    Raises:
        ConfigError: the address is not available.
    """
    options: dict[str, Any] = {"ROUTER_MANDATORY": 1, "HANDSHAKE_IVL": _HANDSHAKE}
    if keys.pair is not None:
        secret = keys.pair.secret.encode()
        options |= {"ZAP_DOMAIN": _DOMAIN, "CURVE_SERVER": 1, "CURVE_SECRETKEY": secret}
    router = _new_socket(context, "ROUTER", address, options)
    try:
        router.bind(address)
    except zmq_module().ZMQError as error:
        router.close(0)
        raise ConfigError(
            f"cannot listen on {address}: {_why(error)}; choose another address, or end the "
            "program that uses it"
        ) from error
    return router


def client_socket(
    context: zmq.Context[Any], address: str, keys: KeyPair | None, server_key: str | None
) -> tuple[zmq.Socket[Any], zmq.Socket[Any]]:
    """Returns a DEALER socket that connects and reconnects automatically, and its monitor.

    Args:
        context: ZeroMQ context.
        address: address of the server.
        keys: the client's keys; required with ``server_key``.
        server_key: the server's public key; ``None`` for no encryption.

    Returns:
        The socket, and a socket with the events of all its connections.

    Raises:
        RemoteError: a connection to the address is impossible.
    """
    options: dict[str, Any] = {"RECONNECT_IVL": 50, "RECONNECT_IVL_MAX": 500}
    if server_key is not None:
        assert keys is not None  # noqa: S101 - RemoteDriverGroup generates them
        options["CURVE_SERVERKEY"] = server_key.encode()
        options["CURVE_PUBLICKEY"] = keys.public.encode()
        options["CURVE_SECRETKEY"] = keys.secret.encode()
    lib = zmq_module()
    failures = (
        lib.EVENT_DISCONNECTED
        | lib.EVENT_HANDSHAKE_FAILED_NO_DETAIL
        | lib.EVENT_HANDSHAKE_FAILED_PROTOCOL
        | lib.EVENT_HANDSHAKE_FAILED_AUTH
    )
    try:
        dealer = _new_socket(context, "DEALER", address, options)
        monitor: zmq.Socket[Any] = dealer.get_monitor_socket(failures)
        dealer.connect(address)
    except lib.ZMQError as error:
        raise RemoteError(f"cannot connect to {address}: {_why(error)}") from error
    return dealer, monitor


def _new_socket(
    context: zmq.Context[Any], socket_type: str, address: str, options: dict[str, Any]
) -> zmq.Socket[Any]:
    lib = zmq_module()
    new: zmq.Socket[Any] = context.socket(getattr(lib, socket_type))
    for name, value in {**_LIMITS, "IPV6": int("[" in address), **options}.items():
        new.setsockopt(getattr(lib, name), value)
    return new


def _why(error: Exception) -> str:
    """Returns ZeroMQ's reason without the address, which the error text already has."""
    return str(error).partition(" (addr=")[0]


class Connections:
    """The connections of a server. Further ones are refused while there are too many.

    ZeroMQ accepts connections until the process has no file descriptors left, and has no call that
    closes one. It closes connections that do not complete their handshake in time, and those of
    clients that no longer send heartbeats.

    Args:
        router: the server's socket, which listens already.

    Attributes:
        identities: identity of each connection by its file descriptor; empty before its first
            message.
        socket: socket with ZeroMQ's events. Call :meth:`update` when it is readable.
    """

    def __init__(self, router: zmq.Socket[Any]) -> None:
        self._zmq, self._router = zmq_module(), router
        self._most = max(_LEAST, min(_MOST, max_descriptors() // _SHARE))
        self.identities: dict[int, bytes] = {}
        self.socket: zmq.Socket[Any] = router.get_monitor_socket(
            self._zmq.EVENT_ACCEPTED | self._zmq.EVENT_DISCONNECTED
        )

    def update(self) -> list[bytes]:
        """Reads all changes, and refuses connections above the limit.

        Returns:
            The identities of connections that have ended. New connections may have their
                descriptors again.
        """
        from zmq.utils.monitor import recv_monitor_message

        ended = []
        while self.socket.EVENTS & self._zmq.POLLIN:
            message = recv_monitor_message(self.socket)
            descriptor = message["value"]
            if message["event"] == self._zmq.EVENT_DISCONNECTED:
                ended.append(self.identities.pop(descriptor, b""))
                continue
            self.identities[descriptor] = b""
            if len(self.identities) > self._most:
                self._shut(descriptor)
                logger.warning("too many connections; further ones are refused until others end")
        return ended

    def _shut(self, descriptor: int) -> None:
        """Shuts a new connection down, unless its descriptor belongs to something else by now."""
        address = self._router.getsockopt_string(self._zmq.LAST_ENDPOINT)
        with suppress(OSError), socket.socket(fileno=os.dup(descriptor)) as connection:
            name = connection.getsockname()
            if isinstance(name, tuple) and address.endswith(f":{name[1]}"):
                connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Stops counting. Call it before you close the router."""
        self._router.disable_monitor()
        self.socket.close(0)


class ClientAuthenticator:
    """Answers ZeroMQ's requests to authenticate clients by their keys (ZAP, RFC 27).

    Args:
        context: ZeroMQ context of the server.
        allowed: public keys of the allowed clients; ``None`` to allow all clients.
    """

    def __init__(self, context: zmq.Context[Any], allowed: Collection[str] | None) -> None:
        zmq = zmq_module()
        from zmq.utils import z85

        self._allowed, self._encode = allowed, z85.encode
        self.socket = context.socket(zmq.REP)
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.bind("inproc://zeromq.zap.01")

    def answer(self) -> None:
        """Answers one request."""
        version, request, domain, _, _, mechanism, *credentials = self.socket.recv_multipart()
        is_ours = version == b"1.0" and domain == _DOMAIN and mechanism == b"CURVE"
        key = self._encode(credentials[0]).decode() if is_ours and credentials else ""
        is_allowed = bool(key) and (self._allowed is None or key in self._allowed)
        status = [b"200", b"OK"] if is_allowed else [b"400", b"this key is not on the list"]
        self.socket.send_multipart(
            [version, request, *status, key.encode() if is_allowed else b"", b""]
        )
        if not is_allowed:
            logger.warning("refused a client whose key is not allowed")


# ---------------------------------------------------------------------- keys

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
#: Maximum size of a key file [bytes].
_MAX_BYTES = 1 << 20
_KEY = re.compile(r"[0-9a-zA-Z.\-:+=^!/*?&<>()\[\]{}@%$#]{40}")


@dataclass(frozen=True, slots=True)
class KeyPair:
    """A public and a secret key, in Z85 encoding.

    Attributes:
        public: key to share.
        secret: key to keep private.
    """

    public: str
    secret: str = field(repr=False)


def new_keys() -> KeyPair:
    """Generates a key pair.

    Raises:
        ConfigError: pyzmq is not installed, or was built without encryption.
    """
    zmq = zmq_module()
    if not zmq.has("curve"):
        raise ConfigError("this pyzmq was built without CURVE; install its wheel from PyPI")
    public, secret = zmq.curve_keypair()
    return KeyPair(public.decode(), secret.decode())


def new_key_files(name: str, folder: Path) -> tuple[Path, Path]:
    """Generates a key pair and writes its files.

    Args:
        name: name of the files, without ``.secret`` and ``.public``.
        folder: folder of the files.

    Returns:
        The paths of the secret file, which only its owner can read, and of the public file.

    Raises:
        ConfigError: the name is invalid, or a file already exists or cannot be written.
    """
    if not _NAME.fullmatch(name):
        raise ConfigError(f"key name {name!r}, expected letters, digits, _ . and -")
    secret_file, public_file = folder / f"{name}.secret", folder / f"{name}.public"
    for file in (secret_file, public_file):
        if file.exists():
            raise ConfigError(f"{file} exists already; choose another name, or remove it first")
    keys = new_keys()
    public = f"public {keys.public} {name}\n"
    secret = f"# A secret key: keep it to yourself.\n{public}secret {keys.secret}\n"
    for file, text, mode in ((secret_file, secret, 0o600), (public_file, public, 0o644)):
        with write_whole(file, "the key") as part:
            part.chmod(mode)
            part.write_text(text)
    return secret_file, public_file


def read_secret(file: str | Path) -> KeyPair:
    """Reads a key pair from a ``.secret`` file.

    Raises:
        ConfigError: the file does not exist, is not a secret key, or other users can read it.
    """
    path = Path(file).expanduser()
    words = dict(line[:2] for line in _lines_of(path))
    if "secret" not in words or "public" not in words:
        raise ConfigError(f"{path} is not a secret key; make one with: stkzoo keys new NAME")
    if os.name == "posix" and path.stat().st_mode & 0o077:
        raise ConfigError(f"other users can read the secret key {path}; first: chmod 600 {path}")
    return KeyPair(words["public"], words["secret"])


def read_public(source: str | Path) -> str:
    """Reads one public key.

    Args:
        source: path of a ``.public`` file, or the key itself (40 characters).

    Raises:
        ConfigError: the source is not exactly one public key.
    """
    keys = read_publics([source])
    if len(keys) != 1:
        raise ConfigError(f"{source} has {len(keys)} public keys, expected one")
    return next(iter(keys))


def read_publics(sources: Iterable[str | Path]) -> set[str]:
    """Reads public keys.

    Args:
        sources: paths of ``.public`` files, of folders of such files, or of concatenated files; or
            the keys themselves.

    Raises:
        ConfigError: a source cannot be read or contains no public key.
    """
    keys: set[str] = set()
    for source in sources:
        path = Path(source).expanduser()
        if not os.path.exists(path) and _KEY.fullmatch(str(source)):
            found = {str(source)}
        else:
            files = path.glob("*.public") if path.is_dir() else [path]
            lines = (line for file in files for line in _lines_of(file))
            found = {line[1] for line in lines if line[0] == "public"}
        if not found:
            raise ConfigError(f"no public key in {source}; make one with: stkzoo keys new NAME")
        keys |= found
    return keys


def _lines_of(path: Path) -> list[list[str]]:
    with reading(f"the key {path} cannot be read", "a file from `stkzoo keys new NAME`"):
        text = read_text(path, _MAX_BYTES)
    lines = [line.split() for line in text.splitlines() if line and not line.startswith("# ")]
    for words in lines:
        if len(words) < 2 or words[0] not in ("public", "secret") or not _KEY.fullmatch(words[1]):
            raise ConfigError(
                f"{path} has an invalid line, expected 'public' or 'secret' and 40 characters"
            )
    return lines
