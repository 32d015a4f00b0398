"""Messages between a program and its engine processes.

A message is a kind (one byte), the number of its frames (one byte), their lengths, and
that many bytes. Nothing is pickled: a frame is arrays by a fixed layout, or JSON. After a
message each end waits for the other's, so that one read of a connection holds one message.
"""

from __future__ import annotations

import os
import socket
import struct
import threading
from collections.abc import Sequence

__all__ = [
    "ACT",
    "BEGIN",
    "DRAW",
    "ERROR",
    "FORK",
    "OK",
    "QUIT",
    "complete",
    "pair",
    "receive",
    "receive_files",
    "send",
    "send_files",
]

#: Requests: start a race (JSON), advance it (control array), end; and to make a copy of the
#: process, which this process answers with nothing, takes a connection and a log for the
#: copy (:func:`send_files`), and answers with the copy's process id. The copy answers on
#: its connection, with nothing.
BEGIN, ACT, QUIT, FORK = b"B", b"A", b"Q", b"F"
#: Request to a process that draws (:mod:`stkzoo.engine.render_process`): move the karts, then look.
DRAW = b"D"
#: Replies: the asked-for bytes, or a JSON object with ``type``, ``message``, ``traceback``.
OK, ERROR = b"O", b"E"

_HEADER = struct.Struct("<cB")
#: No message of ours comes near; a larger length is a sign of a broken stream.
_MAX_LENGTH = 1 << 28
#: More than a message between processes of one machine can have: one call reads it.
_ONE_READ = 1 << 18


def pair() -> tuple[socket.socket, socket.socket]:
    """Both ends of a connection within this machine.

    It carries each message in one piece, which is quicker than a stream.
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
    room = _room.bytes
    return complete(connection, bytes(room[: connection.recv_into(room)]))


def complete(connection: socket.socket, data: bytes) -> tuple[bytes, list[bytes]]:
    """The kind and the frames of a message that begins with some bytes.

    Raises: as :func:`receive`.
    """
    data = _at_least(connection, data, _HEADER.size)
    kind, count = _HEADER.unpack_from(data)
    begin = _HEADER.size + 4 * count
    data = _at_least(connection, data, begin)
    lengths = struct.unpack_from(f"<{count}I", data, _HEADER.size)
    size = begin + sum(lengths)
    if size > _MAX_LENGTH:
        raise EOFError(f"a message of {size} bytes makes no sense here")
    data = _at_least(connection, data, size)
    if len(data) > size:
        raise EOFError("more came than was asked for")
    frames = []
    for length in lengths:
        frames.append(data[begin : begin + length])
        begin += length
    return kind, frames


def send_files(connection: socket.socket, files: Sequence[int]) -> None:
    """Hands open files over, by their descriptors; only between processes of one machine.

    They travel with one byte of their own, so that the stream of messages stays in order.
    """
    socket.send_fds(connection, [b"f"], files)


def receive_files(connection: socket.socket, count: int) -> list[int]:
    """Waits for the files of one :func:`send_files`; the descriptors are the caller's.

    Raises:
        EOFError: the other end is gone.
        OSError: other files came than were expected, or this process may open no more.
    """
    data, files, _, _ = socket.recv_fds(connection, 1, count)
    if not data:
        raise EOFError("the connection was closed")
    if len(files) != count:
        for file in files:
            os.close(file)
        raise OSError(f"{len(files)} of {count} open files came; are too many open?")
    return list(files)


class _Room(threading.local):
    """What messages are read into, kept because as much new memory for each takes longer."""

    def __init__(self) -> None:
        self.bytes = memoryview(bytearray(_ONE_READ))


_room = _Room()


def _at_least(connection: socket.socket, data: bytes, size: int) -> bytes:
    """Reads on until there are so many bytes."""
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
