"""The messages between the two ends of a networked race (``docs/protocol.md``).

A message is two ZeroMQ frames: its kind, one byte, and its body, a dict encoded by
:mod:`stkzoo.race.codec`.
"""

from __future__ import annotations

from typing import Any, TypeVar

from stkzoo.errors import ProtocolError
from stkzoo.race.agents import failures
from stkzoo.race.codec import Limits, decode, encode

__all__ = [
    "ACT",
    "ACTED",
    "ALIVE",
    "BYE",
    "CLOSE",
    "ERROR",
    "HELLO",
    "LIMITS",
    "MAX_SEATS",
    "OPEN",
    "OPENED",
    "VERSION",
    "WELCOME",
    "pack",
    "printable",
    "take",
    "take_version",
    "unpack",
]

#: Both ends must speak the same.
VERSION = 1

# From client to server.
HELLO, OPEN, ACT, CLOSE, BYE = b"H", b"O", b"A", b"C", b"B"
# From server to client.
WELCOME, OPENED, ACTED, ALIVE, ERROR = b"W", b"P", b"D", b"L", b"E"

#: Twenty observations of the longest track fit in half of it.
LIMITS = Limits(max_bytes=4 << 20)

#: Seats of one client on one server.
MAX_SEATS = 32

_MAX_TEXT = 4000

Field = TypeVar("Field")


def pack(**fields: Any) -> bytes:
    """The body of a message.

    Raises:
        ProtocolError: it cannot be sent.
    """
    return encode(fields, LIMITS)


def unpack(body: bytes, *, limits: Limits = LIMITS) -> dict[str, Any]:
    """The fields of a message's body.

    Raises:
        ProtocolError: it is no message.
    """
    fields = decode(body, limits)
    if type(fields) is not dict:
        raise ProtocolError(f"a {type(fields).__name__} came, expected a dict")
    return fields


def take(fields: dict[str, Any], name: str, kind: type[Field]) -> Field:
    """One field, which must be there and of exactly this type.

    Raises:
        ProtocolError: it is not.
    """
    value = fields.get(name)
    if type(value) is not kind:
        raise ProtocolError(f"{name} is {value!r:.100}, expected {kind.__name__}")
    return value


def take_version(fields: dict[str, Any]) -> int:
    """The version of the protocol that the other end speaks, if it is ours.

    Raises:
        ProtocolError: it is another, or none.
    """
    protocol = take(fields, "protocol", int)
    if protocol != VERSION:
        raise ProtocolError(
            f"the other end speaks protocol {protocol}, this one {VERSION}; "
            "install the same stkzoo on both sides"
        )
    return protocol


def printable(text: object, limit: int = _MAX_TEXT) -> str:
    """What somebody else wrote, fit for a terminal: no control codes, not too long."""
    return failures.printable(text)[:limit]
