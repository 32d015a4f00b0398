"""The messages between client and server of a networked race (``docs/reference/protocol.md``).

A message is two ZeroMQ frames: its kind, one byte, and its body, a dict encoded by
:mod:`stkzoo.drivers.codec`. A *seat* is the number of a driver instance on one connection.
"""

from __future__ import annotations

from typing import Any, TypeVar

from stkzoo.drivers.codec import Limits, decode, encode
from stkzoo.errors import ProtocolError, shortened
from stkzoo.mdp.spaces import EXTRAS

#: Both ends must have the same.
VERSION = 3

# From client to server.
HELLO, OPEN, ACT, CLOSE, BYE = b"H", b"O", b"A", b"C", b"B"
# From server to client.
WELCOME, OPENED, ACTED, ALIVE, ERROR = b"W", b"P", b"D", b"L", b"E"

#: Twenty observations of the longest track need half of it.
LIMITS = Limits(max_bytes=4 << 20)

#: Driver instances of one client on one server.
MAX_SEATS = 32

Field = TypeVar("Field")


def pack(**fields: Any) -> bytes:
    """The body of a message.

    Raises:
        ProtocolError: it is not plain data, or too large.
    """
    return encode(fields, LIMITS)


def unpack(body: bytes, *, limits: Limits = LIMITS) -> dict[str, Any]:
    """The fields of a message's body.

    Raises:
        ProtocolError: these bytes are not a message.
    """
    fields = decode(body, limits)
    if type(fields) is not dict:
        raise ProtocolError(f"a {type(fields).__name__} came, expected a dict")
    return fields


def field(fields: dict[str, Any], name: str, kind: type[Field]) -> Field:
    """One field, which must exist and have exactly this type.

    Raises:
        ProtocolError: it is missing or has another type.
    """
    value = fields.get(name)
    if type(value) is not kind:
        raise ProtocolError(f"{name} is {shortened(value, 100)}, expected {kind.__name__}")
    return value


def check_extras(extras: list[Any]) -> list[str]:
    """Checks what an agent observes in addition to the ``full`` view.

    Raises:
        ProtocolError: it is more than this end knows.
    """
    if not all(isinstance(extra, str) and extra in EXTRAS for extra in extras):
        raise ProtocolError(
            f"extras is {shortened(extras, 100)}, expected some of {', '.join(EXTRAS)}"
        )
    return extras


def check_version(fields: dict[str, Any]) -> None:
    """Checks that the other end has the same version of the protocol.

    Raises:
        ProtocolError: it has another, or none.
    """
    protocol = field(fields, "protocol", int)
    if protocol != VERSION:
        raise ProtocolError(
            f"the other end speaks protocol {protocol}, this one {VERSION}; "
            "install the same stkzoo on both sides"
        )
