"""Messages between a program and its engine processes.

A message is a kind (one byte), the number of its frames (one byte), their lengths, and the
frames. Nothing is pickled: a frame holds arrays in a fixed layout, or JSON. After a message
each end waits for the other's, so one read of a connection holds one message.
"""

from __future__ import annotations

import os
import socket
import struct
import threading
from collections.abc import Sequence

#: Requests: start a race (JSON), advance it (control array), end, and clone the process. To
#: clone, the process sends an empty reply, receives a connection and a log for the clone
#: (:func:`send_files`), and replies with the clone's process id. The clone sends an empty
#: reply on its own connection.
BEGIN, ACT, QUIT, FORK = b"B", b"A", b"Q", b"F"
#: Request to the render process (:mod:`stkzoo.engine.render_process`): move the karts and draw.
DRAW = b"D"
#: Replies: the requested bytes, or a JSON object with ``type``, ``message``, ``traceback``.
OK, ERROR = b"O", b"E"

_HEADER = struct.Struct("<cB")
#: Far more than any message has; a larger length means a broken stream.
_MAX_LENGTH = 1 << 28
#: More than a message on one machine can have, so one call reads it.
_ONE_READ = 1 << 18


def pair() -> tuple[socket.socket, socket.socket]:
    """Both ends of a connection within this machine.

    It carries each message in one piece, which is faster than a stream.
    """
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def send(connection: socket.socket, kind: bytes, *frames: bytes) -> None:
    """Sends one message."""
    head = struct.pack(f"<cB{len(frames)}I", kind, len(frames), *map(len, frames))
    connection.sendall(b"".join([head, *frames]))


def receive(connection: socket.socket) -> tuple[bytes, list[bytes]]:
    """Waits for one message and returns its kind and its frames.

    Raises:
        EOFError: the other end is gone.
        TimeoutError: the socket's time-out passed.
    """
    room = _read_buffer.bytes
    return complete(connection, bytes(room[: connection.recv_into(room)]))


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


def send_files(connection: socket.socket, files: Sequence[int]) -> None:
    """Sends open files by their descriptors, to a process on this machine.

    They travel with one byte of their own, which keeps the stream of messages in order.
    """
    socket.send_fds(connection, [b"f"], files)


def receive_files(connection: socket.socket, count: int) -> list[int]:
    """Waits for the files of one :func:`send_files`; the caller owns the descriptors.

    Raises:
        EOFError: the other end is gone.
        OSError: another number of files came, or this process may open no more.
    """
    data, files, _, _ = socket.recv_fds(connection, 1, count)
    if not data:
        raise EOFError("the connection was closed")
    if len(files) != count:
        for file in files:
            os.close(file)
        raise OSError(f"{len(files)} of {count} open files came; are too many open?")
    return list(files)


class _ReadBuffer(threading.local):
    """The buffer that messages are read into; allocating one for each message is slower."""

    def __init__(self) -> None:
        self.bytes = memoryview(bytearray(_ONE_READ))


_read_buffer = _ReadBuffer()


def _at_least(connection: socket.socket, data: bytes, size: int) -> bytes:
    """Reads until there are ``size`` bytes."""
    if len(data) >= size:
        return data
    if not data:
        raise EOFError("the connection was closed")
    parts = [data]
    count = len(data)
    while count < size:
        part = connection.recv(size - count)
        if not part:
            raise EOFError("the connection was closed")
        parts.append(part)
        count += len(part)
    return b"".join(parts)
