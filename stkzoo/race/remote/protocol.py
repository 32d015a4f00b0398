"""Messages between client and server of a networked race (``docs/reference/protocol.md``).

Each message is one ZeroMQ frame with a struct of :mod:`stkzoo.drivers.messages`. A *seat* is the
number of an agent on one connection.
"""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

import msgspec
from msgspec import Meta, Struct

from stkzoo.drivers.messages import (
    Count,
    Decided,
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
VERSION = 5

#: Maximum number of agents of one client on one server.
MAX_SEATS = 32
_MAX_AGENTS = 1000

Extra: TypeAlias = Annotated[str, Meta(pattern=rf"^({'|'.join(EXTRAS)})\Z")]
Extras: TypeAlias = Annotated[list[Extra], Meta(max_length=len(EXTRAS))]
Seconds: TypeAlias = Annotated[float, Meta(gt=0, lt=1e9)]
Duration: TypeAlias = Annotated[float, Meta(ge=0, lt=1e9)]

# ---------------------------------------------------------------------- from the client


class Hello(Message):
    """The first message."""

    protocol: int
    stkzoo: Name


class Open(Message):
    """Requests a seat for an agent. A client never reuses the number of a seat."""

    seat: Count
    driver: Count
    agent: Name
    extras: Extras
    seed: int
    action_timeout: Seconds | None
    start_timeout: Seconds


class Act(Message):
    """The observations of one step, encoded, by seat."""

    step: Count
    observations: Annotated[list[tuple[Count, bytes]], Meta(max_length=MAX_SEATS)]


class Close(Message):
    """Releases a seat."""

    seat: Count


class Bye(Message):
    """Releases all seats."""


ClientMessage: TypeAlias = Hello | Open | Act | Close | Bye

# ---------------------------------------------------------------------- from the server


class Offer(Struct, frozen=True, forbid_unknown_fields=True):
    """An agent of the server: its name, its source and its additional observation entries."""

    name: Name
    source: LongText
    extras: Extras


class Welcome(Message):
    """The reply to a hello."""

    protocol: int
    stkzoo: Name
    agents: Annotated[list[Offer], Meta(min_length=1, max_length=_MAX_AGENTS)]


class Opened(Message):
    """The agent of a seat is ready, or has failed to start."""

    seat: Count
    outcome: Ready | Failed


class Answer(Struct, frozen=True, forbid_unknown_fields=True):
    """The outcome of a step for one seat.

    Attributes:
        seat: the seat.
        outcome: the decision, or why there is none.
        seconds: duration of the decision, as the server measured it [s].
        is_usable: whether the agent accepts further observations.
    """

    seat: Count
    outcome: Decided | Failed
    seconds: Duration
    is_usable: bool


class Acted(Message):
    """The reply to the observations of a step, with one answer for each seat."""

    step: Count
    answers: Annotated[list[Answer], Meta(max_length=MAX_SEATS)]


class Alive(Message):
    """Checks whether the client is still connected."""


class Refused(Message):
    """The session ends."""

    reason: LongText


ServerMessage: TypeAlias = Welcome | Opened | Acted | Alive | Refused

_from_client = msgspec.msgpack.Decoder(ClientMessage)
_from_server = msgspec.msgpack.Decoder(ServerMessage)


def read_request(frames: list[bytes]) -> ClientMessage:
    """Decodes a client's message.

    Raises:
        ProtocolError: the frames are not such a message, or it has another version.
    """
    message: ClientMessage = _read(_from_client, frames)
    return message


def read_reply(frames: list[bytes]) -> ServerMessage:
    """Decodes a server's message.

    Raises:
        ProtocolError: the frames are not such a message, or it has another version.
    """
    message: ServerMessage = _read(_from_server, frames)
    return message


def _read(decoder: msgspec.msgpack.Decoder[Any], frames: list[bytes]) -> Any:
    if len(frames) != 1:
        raise ProtocolError("a message of several frames came, expected one frame")
    message = decode(decoder, frames[0])
    if isinstance(message, Hello | Welcome) and message.protocol != VERSION:
        raise ProtocolError(
            f"the other end speaks protocol {message.protocol}, this one {VERSION}; "
            "install the same stkzoo on both sides"
        )
    return message
