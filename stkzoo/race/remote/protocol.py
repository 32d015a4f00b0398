"""Messages between client and server of a networked race (``docs/reference/protocol.md``).

A message consists of two ZeroMQ frames: its kind, which is one byte, and its body, which is a dict
encoded with :mod:`stkzoo.drivers.codec`. A *seat* is the number of a driver instance on one
connection.
"""

from __future__ import annotations

from typing import Any, TypeVar

from stkzoo.drivers.codec import Limits, decode, encode
from stkzoo.errors import ProtocolError, shortened
from stkzoo.mdp.spaces import EXTRAS

#: Version of the protocol; both ends must have the same one.
VERSION = 3

# From client to server.
HELLO, OPEN, ACT, CLOSE, BYE = b"H", b"O", b"A", b"C", b"B"
# From server to client.
WELCOME, OPENED, ACTED, ALIVE, ERROR = b"W", b"P", b"D", b"L", b"E"

#: Fields of the server's messages with a body.
_FIELDS = {
    WELCOME: {"protocol", "stkzoo", "agents", "action_timeout"},
    OPENED: {"seat", "name", "paths_used", "error"},
    ACTED: {"step", "decisions", "failures"},
    ERROR: {"text"},
}

#: Limits of a message. Twenty observations of the longest track need half of ``max_bytes``.
LIMITS = Limits(max_bytes=4 << 20)

#: Maximum number of driver instances of one client on one server.
MAX_SEATS = 32

Field = TypeVar("Field")


def pack(**fields: Any) -> bytes:
    """Encodes the body of a message.

    Raises:
        ProtocolError: the fields are not plain data, or are too large.
    """
    return encode(fields, LIMITS)


def unpack(body: bytes, *, limits: Limits = LIMITS) -> dict[str, Any]:
    """Decodes the body of a message to its fields.

    Raises:
        ProtocolError: the bytes are not a valid body.
    """
    fields = decode(body, limits)
    if type(fields) is not dict:
        raise ProtocolError(f"got {type(fields).__name__}, expected dict")
    return fields


def field(fields: dict[str, Any], name: str, kind: type[Field]) -> Field:
    """Returns a required field and checks that it has exactly this type.

    Raises:
        ProtocolError: the field is missing or has another type.
    """
    value = fields.get(name)
    if type(value) is not kind:
        raise ProtocolError(f"{name} is {shortened(value, 100)}, expected {kind.__name__}")
    return value


def check_fields(kind: bytes, fields: dict[str, Any]) -> None:
    """Checks the kind of a server's message, and that it has no unknown fields.

    Raises:
        ProtocolError: the kind or a field is unknown.
    """
    if kind not in _FIELDS:
        raise ProtocolError(f"message kind {shortened(kind, 20)} came")
    if unknown := fields.keys() - _FIELDS[kind]:
        raise ProtocolError(
            f"unknown fields {shortened(sorted(unknown), 100)}, expected some of "
            f"{', '.join(sorted(_FIELDS[kind]))}"
        )


def check_extras(extras: list[Any]) -> list[str]:
    """Checks the names of the entries that an agent observes beyond the ``full`` view.

    Raises:
        ProtocolError: a name is unknown.
    """
    if not all(isinstance(extra, str) and extra in EXTRAS for extra in extras):
        raise ProtocolError(
            f"extras is {shortened(extras, 100)}, expected some of {', '.join(EXTRAS)}"
        )
    return extras


def check_version(fields: dict[str, Any]) -> None:
    """Checks that the other end has the same protocol version.

    Raises:
        ProtocolError: the version differs or is missing.
    """
    protocol = field(fields, "protocol", int)
    if protocol != VERSION:
        raise ProtocolError(
            f"the other end speaks protocol {protocol}, this one {VERSION}; "
            "install the same stkzoo on both sides"
        )
