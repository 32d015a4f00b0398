"""Messages between client and server of a networked race (``docs/reference/protocol.md``).

Each message is one ZeroMQ frame with a struct of :mod:`stkzoo.drivers.messages`. Each agent has its
own connection.
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

from msgspec import Meta, Struct
from msgspec.msgpack import Decoder

from stkzoo.drivers.messages import (
    Count,
    Decided,
    Decoded,
    Failed,
    LongText,
    Message,
    Name,
    Ready,
    decode,
)
from stkzoo.errors import ProtocolError
from stkzoo.mdp.spaces import EXTRAS

#: Version of the protocol; both ends must have the same one.
VERSION = 6

#: Maximum number of agents of one client on one server.
MAX_AGENTS = 32
#: Maximum number of agents that a server offers, and size of an observation [bytes].
_MAX_OFFERS, _MAX_OBSERVATION = 1000, 1 << 20

Extra: TypeAlias = Annotated[str, Meta(pattern=rf"^({'|'.join(EXTRAS)})\Z")]
Extras: TypeAlias = Annotated[list[Extra], Meta(max_length=len(EXTRAS))]
_Version: TypeAlias = Annotated[int, Meta(ge=0, le=10_000)]
Seconds: TypeAlias = Annotated[float, Meta(gt=0, lt=1e9)]

# ---------------------------------------------------------------------- from the client


class Hello(Message):
    """The first message."""

    protocol: _Version
    stkzoo: Name


class Open(Message):
    """Requests an agent for this connection; ``client`` is the same for all agents of a client."""

    client: Annotated[str, Meta(min_length=16, max_length=64)]
    driver: Count
    agent: Name
    extras: Extras
    seed: int
    action_timeout: Seconds | None
    start_timeout: Seconds


class Act(Message):
    """Requests the decision on an encoded observation."""

    observation: Annotated[bytes, Meta(max_length=_MAX_OBSERVATION)]


class Bye(Message):
    """Releases the agent; it has no reply."""


ClientMessage: TypeAlias = Hello | Open | Act | Bye

# ---------------------------------------------------------------------- from the server


class Offer(Struct, frozen=True, forbid_unknown_fields=True):
    """An agent of the server: its name, its source and its additional observation entries."""

    name: Name
    source: LongText
    extras: Extras


class Welcome(Message):
    """The reply to a hello."""

    protocol: _Version
    stkzoo: Name
    agents: Annotated[list[Offer], Meta(min_length=1, max_length=_MAX_OFFERS)]


class Refused(Message):
    """Instead of any reply: the connection ends."""

    reason: LongText


ServerMessage: TypeAlias = Welcome | Ready | Decided | Failed | Refused

_from_client: Decoder[ClientMessage] = Decoder(ClientMessage)
_from_server: Decoder[ServerMessage] = Decoder(ServerMessage)


def read_request(frames: list[bytes]) -> ClientMessage:
    """Decodes a client's message.

    Raises:
        ProtocolError: the frames are not such a message, or it has another version.
    """
    return _read(_from_client, frames)


def read_reply(frames: list[bytes]) -> ServerMessage:
    """Decodes a server's message.

    Raises:
        ProtocolError: the frames are not such a message, or it has another version.
    """
    return _read(_from_server, frames)


def _read(decoder: Decoder[Decoded], frames: list[bytes]) -> Decoded:
    if len(frames) != 1:
        raise ProtocolError("a message of several frames came, expected one frame")
    message = decode(decoder, frames[0])
    if isinstance(message, Hello | Welcome) and message.protocol != VERSION:
        raise ProtocolError(
            f"the other end speaks protocol {message.protocol}, this one {VERSION}; "
            "install the same stkzoo on both sides"
        )
    return message
