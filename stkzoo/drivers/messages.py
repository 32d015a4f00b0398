"""Messages between a race and its agents in other processes and on other machines.

Each message is a msgspec struct in MessagePack. Decoding checks all types and bounds, creates
nothing but the declared fields, runs no code from the message and raises only
:class:`~stkzoo.errors.ProtocolError`. Nothing is pickled.

Observations are the only part whose entries are not declared. An observation is a map from names to
whole numbers, texts, arrays and rows (a tuple of arrays or numbers of equal shape and type);
``docs/reference/protocol.md`` describes their form. Decoding one takes at most 16 bytes of memory
per byte, plus 1 MiB.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta, Struct
from msgspec.msgpack import Ext

from stkzoo._schema import plain_name
from stkzoo.drivers.confinement import Confinement
from stkzoo.drivers.failures import MAX_TEXT, agent_trace, bounded, in_words, printable
from stkzoo.drivers.files import AgentPlace
from stkzoo.drivers.instances import Decision, DriverInstance
from stkzoo.errors import AgentError, AgentTimeout, ProtocolError
from stkzoo.kernel import join_rows
from stkzoo.mdp.spaces import action_of, controls_of

#: Maximum size of a message [bytes]. The largest is the first of a race on ``black_forest``: 20
#: karts with all optional entries of the ``full`` view need 1.5 MB there, and 0.2 to 0.4 MB on
#: the other tracks.
MAX_BYTES = 4 << 20
#: Maximum size of an agent's reply [bytes]: an action, or the report of an error.
MAX_REPLY = 64 << 10
#: Maximum length of an agent's name [characters].
MAX_NAME = 100

#: Maximum number of entries of an observation, and length of each axis of an array.
_MAX_ENTRIES, _MAX_LENGTH = 64, 8192
_MAX_AXES = 4
#: Memory limit of an observation [bytes per byte], additional memory of a short one, and memory of
#: one row [bytes]. The observation of the longest track needs 14 bytes per byte.
_MEMORY_PER_BYTE, _MEMORY_OF_SHORT, _ROW = 16, 1 << 20, 128

# Codes of the MessagePack extension types.
_ARRAY, _ROWS = 1, 2
_DTYPES = tuple(map(np.dtype, ("<f4", "<f8", "|i1", "<i8", "|u1")))
_CODES = {dtype: code for code, dtype in enumerate(_DTYPES)}
_HEADERS = [struct.Struct(f"<BB{axes}H") for axes in range(_MAX_AXES + 1)]

Decoded = TypeVar("Decoded")
Count: TypeAlias = Annotated[int, Meta(ge=0, lt=1 << 62)]
Name: TypeAlias = Annotated[str, Meta(max_length=MAX_NAME)]
LongText: TypeAlias = Annotated[str, Meta(max_length=2 * MAX_TEXT)]
_Share: TypeAlias = Annotated[float, Meta(ge=0, le=1)]
_Steer: TypeAlias = Annotated[float, Meta(ge=-1, le=1)]


class Message(Struct, forbid_unknown_fields=True, tag=str.lower):
    """A message, whose tag is the name of its class."""


# ---------------------------------------------------------------------- an agent's process


class LoadRequest(Message):
    """From the race: how to load the agent, and the limits of its process.

    All later messages from the race are encoded observations.
    """

    agent: str
    place: AgentPlace
    adapter: str | None
    seed: int
    memory: int
    extras: list[str]
    cpu_time: float | None
    confinement: Confinement | None


class Ready(Message):
    """From the agent: its name, and how many track segments it uses (``None`` for all)."""

    name: Name
    paths_used: Annotated[int, Meta(ge=0, le=_MAX_LENGTH)] | None


class Decided(Message):
    """From the agent: the action, and whether a number was clipped to its space.

    An action is a row of controls, with the columns of :data:`~stkzoo.engine.snapshot.CONTROLS`.
    """

    action: tuple[_Share, _Steer, _Share, _Share, _Share, _Share, _Share]
    is_clipped: bool

    @classmethod
    def of(cls, decision: Decision) -> Decided:
        """Returns the message for a decision."""
        row: Any = tuple(controls_of(decision.action))
        return cls(row, decision.is_clipped)

    def decision(self, seconds: float) -> Decision:
        """Returns the decision, which took a time [s]."""
        return Decision(action_of(np.array(self.action, np.float32)), seconds, self.is_clipped)


class Failed(Message):
    """From the agent: why there is no action, or why the agent could not be loaded.

    ``is_usable`` is whether the agent accepts further observations.
    """

    kind: Literal["error", "timeout"]
    text: LongText
    trace: LongText
    is_usable: bool

    @classmethod
    def of(cls, error: BaseException, *, is_usable: bool = False) -> Failed:
        """Returns the report of an exception."""
        trace = error.trace if isinstance(error, AgentError) else agent_trace(error)
        return cls(
            "timeout" if isinstance(error, AgentTimeout) else "error",
            printable(in_words(error), MAX_TEXT),
            printable(bounded(str(trace))),
            is_usable,
        )

    def error(self, agent: str = "", seconds: float = 0.0, server: str = "") -> AgentError:
        """Returns the error of an agent.

        Args:
            agent: id of the agent.
            seconds: time that the agent took [s].
            server: address of its server, which begins the text; empty without a server.
        """
        error_type = AgentTimeout if self.kind == "timeout" else AgentError
        text, trace = (printable(part, MAX_TEXT) for part in (self.text, self.trace))
        return error_type(f"{server}: {text}" if server else text, agent, trace, seconds)


Reply: TypeAlias = Ready | Decided | Failed


def start_reply(agent: DriverInstance) -> Ready | Failed:
    """Waits until an agent is ready and returns the message about it."""
    try:
        name = plain_name(agent.ready())
    except Exception as error:  # noqa: BLE001 - an agent may raise anything
        return Failed.of(error)
    paths = getattr(agent, "paths_used", None)
    return Ready(name, None if paths is None else min(paths, _MAX_LENGTH))


# ---------------------------------------------------------------------- coding

_encoder = msgspec.msgpack.Encoder()
_observations: msgspec.msgpack.Decoder[dict[str, Any]] = msgspec.msgpack.Decoder(
    Annotated[dict[Name, int | str | Ext], Meta(max_length=_MAX_ENTRIES)]
)


def encode(message: Struct) -> bytes:
    """Encodes a message.

    Raises:
        ProtocolError: the message is too long, or contains a number of more than 64 bits.
    """
    try:
        data = _encoder.encode(message)
    except OverflowError as error:
        raise ProtocolError(f"a message cannot be encoded: {error}") from error
    check_size(len(data))
    return data


def decode(decoder: msgspec.msgpack.Decoder[Decoded], data: bytes) -> Decoded:
    """Decodes a message.

    Args:
        decoder: decoder of the expected messages.
        data: the message.

    Raises:
        ProtocolError: the bytes are no such message.
    """
    check_size(len(data))
    try:
        return decoder.decode(data)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ProtocolError(
            f"{len(data)} bytes came that are not a valid message: {printable(error, 200)}"
        ) from error


def check_size(size: int, most: int = MAX_BYTES) -> None:
    """Checks the size of a message [bytes].

    Raises:
        ProtocolError: the message is too long.
    """
    if size > most:
        raise ProtocolError(f"a message of {size} bytes came, expected at most {most}")


def encode_observation(observation: Mapping[str, Any], paths_used: int | None = None) -> bytes:
    """Encodes an observation of the ``full`` view.

    Args:
        observation: the observation.
        paths_used: number of track segments that the agent uses; the others are left out. ``None``
            for all.
    """
    return _encoder.encode(
        {
            name: _encoded(value[:paths_used] if name.startswith("paths_") else value)
            for name, value in observation.items()
        }
    )


def decode_observation(data: bytes) -> dict[str, Any]:
    """Decodes an observation. Its arrays are writable.

    Raises:
        ProtocolError: the bytes are not an observation, or it takes too much memory.
    """
    entries = decode(_observations, data)
    memory = _MEMORY_PER_BYTE * len(data) + _MEMORY_OF_SHORT
    for name, entry in entries.items():
        if isinstance(entry, Ext):
            array = _decoded(entry)
            if entry.code == _ROWS:
                memory -= _ROW * len(array)
                if memory < 0:
                    raise ProtocolError("an observation of more rows than any track has")
            entries[name] = tuple(array) if entry.code == _ROWS else array
    return entries


def _encoded(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return Ext(_ARRAY, _header(value.dtype, value.shape) + value.tobytes())
    if isinstance(value, tuple):
        first = np.asarray(value[0] if value else 0.0)
        data = join_rows(value)
        if data is None:  # numbers, or no rows
            data = np.array(value, first.dtype).tobytes()
        return Ext(_ROWS, _header(first.dtype, (len(value), *first.shape)) + data)
    return int(value) if isinstance(value, np.integer) else value


def _header(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    return _HEADERS[len(shape)].pack(_CODES[dtype], len(shape), *shape)


def _decoded(entry: Ext) -> npt.NDArray[Any]:
    """Returns the array of an extension.

    Raises:
        ProtocolError: the extension has another form, or its size does not match its shape.
    """
    data = memoryview(entry.data)
    try:
        layout = _HEADERS[data[1]]
        code, _, *shape = layout.unpack_from(data)
        dtype = _DTYPES[code]
    except (IndexError, struct.error):
        raise ProtocolError("an array of an unknown dtype or number of axes") from None
    if entry.code not in (_ARRAY, _ROWS) or (entry.code == _ROWS and len(shape) not in (1, 2)):
        raise ProtocolError("an extension that is neither an array nor rows")
    if max(shape, default=0) > _MAX_LENGTH:
        raise ProtocolError(f"an axis of length {max(shape)}, expected at most {_MAX_LENGTH}")
    if math.prod(shape) * dtype.itemsize != len(data) - layout.size:
        raise ProtocolError(f"an array of {len(data)} bytes, which do not match its shape {shape}")
    array: npt.NDArray[Any] = np.ndarray(shape, dtype, data, layout.size).copy()  # writable
    return array
