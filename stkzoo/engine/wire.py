"""Messages between a program and its engine processes.

A message is a kind (one byte), the number of its frames (one byte), their lengths, and the
frames. Nothing is pickled: a frame holds arrays in a fixed layout, or JSON. After a message
each end waits for the other's, so one read of a connection holds one message.
"""

from __future__ import annotations

import json
import socket
import struct
import threading
import traceback
from collections.abc import Sequence

from stkzoo._os import above_standard_streams, file_identity

#: Requests: start a race (JSON), and advance it (control array).
BEGIN, ACT = b"B", b"A"
#: Request to fork the process, which brings a connection and a log for the new one. There is no
#: reply: the new process sends its process id on its own connection.
FORK = b"F"
#: Requests to a fork server, with a child's process id: end the child and reply with its id and
#: its wait status; and end it without a reply.
END, DROP = b"X", b"D"
#: Request to the render process (:mod:`stkzoo.engine.render_process`): move the karts and draw.
DRAW = b"P"
#: Replies: the requested bytes, or a JSON object with ``type``, ``message``, ``traceback``.
OK, ERROR = b"O", b"E"

_HEADER = struct.Struct("<cB")
#: Far more than any message has; a larger length means a broken stream.
_MAX_LENGTH = 1 << 28
#: More than a message on one machine can have, so one call reads it.
_ONE_READ = 1 << 18


class EngineConnection(socket.socket):
    """A socket that a program may close behind our back (:class:`stkzoo._os.OwnDescriptor`).

    Args:
        fileno: its descriptor, which must be open.
    """

    def __init__(self, fileno: int) -> None:
        super().__init__(fileno=above_standard_streams(fileno))
        self._identity = file_identity(self.fileno())

    @property
    def is_lost(self) -> bool:
        """Whether the descriptor is closed or is of another file by now."""
        return self.fileno() < 0 or file_identity(self.fileno()) != self._identity

    def close(self) -> None:
        """Closes the socket, unless its descriptor is somebody else's by now."""
        if self.is_lost:
            self.detach()
        super().close()


def pair() -> tuple[EngineConnection, EngineConnection]:
    """Both ends of a connection within this machine.

    It carries each message in one piece, which is faster than a stream.
    """
    first, second = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    return EngineConnection(first.detach()), EngineConnection(second.detach())


def send(connection: socket.socket, kind: bytes, *frames: bytes, files: Sequence[int] = ()) -> None:
    """Sends one message, and open files by their descriptors to a process on this machine."""
    head = struct.pack(f"<cB{len(frames)}I", kind, len(frames), *map(len, frames))
    message = b"".join([head, *frames])
    if files:
        socket.send_fds(connection, [message], files)
    else:
        connection.sendall(message)


def receive(connection: socket.socket) -> tuple[bytes, list[bytes]]:
    """Waits for one message and returns its kind and its frames.

    Raises:
        EOFError: the other end is gone.
        TimeoutError: the socket's time-out passed.
    """
    room = _read_buffer.bytes
    return complete(connection, bytes(room[: connection.recv_into(room)]))


def receive_with_files(connection: socket.socket) -> tuple[bytes, list[bytes], list[int]]:
    """:func:`receive`, and the descriptors of at most two open files, which the caller owns.

    Fewer come where this process may open no more.
    """
    data, files, _, _ = socket.recv_fds(connection, _ONE_READ, 2)
    return (*complete(connection, data), list(files))


def complete(connection: socket.socket, data: bytes) -> tuple[bytes, list[bytes]]:
    """Reads the rest of a message that begins with ``data``; returns its kind and frames.

    Raises: as :func:`receive`.
    """
    data = _at_least(connection, data, _HEADER.size)
    kind, count = _HEADER.unpack_from(data)
    begin = _HEADER.size + 4 * count
    data = _at_least(connection, data, begin)
    lengths = struct.unpack_from(f"<{count}I", data, _HEADER.size)
    size = begin + sum(lengths)
    if size > _MAX_LENGTH:
        raise EOFError(f"a message of {size} bytes is too large")
    data = _at_least(connection, data, size)
    if len(data) > size:
        raise EOFError("the message is longer than its header says")
    frames = []
    for length in lengths:
        frames.append(data[begin : begin + length])
        begin += length
    return kind, frames


def send_error(connection: socket.socket, error: Exception) -> None:
    """Replies with the error that is being handled."""
    facts = {"type": type(error).__name__, "message": str(error)}
    text = json.dumps({**facts, "traceback": traceback.format_exc()})
    send(connection, ERROR, text.encode())


class _ReadBuffer(threading.local):
    """The buffer that messages are read into; allocating one for each message is slower."""

    def __init__(self) -> None:
        self.bytes = memoryview(bytearray(_ONE_READ))


_read_buffer = _ReadBuffer()


def _at_least(connection: socket.socket, data: bytes, size: int) -> bytes:
    """Reads until there are ``size`` bytes."""
    if len(data) >= size:
        return data
    whole = bytearray(data)
    while len(whole) < size:
        part = connection.recv(size - len(whole)) if data else b""
        if not part:
            raise EOFError("the connection was closed")
        whole += part
    return bytes(whole)
