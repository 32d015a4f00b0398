"""Messages between a program and its engine processes.

A message is a kind (one byte), a length and that many bytes. Nothing is pickled:
the bytes are arrays by a fixed layout, or JSON.
"""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Sequence

__all__ = [
    "ACT",
    "BEGIN",
    "ERROR",
    "FORK",
    "OK",
    "QUIT",
    "receive",
    "receive_files",
    "send",
    "send_files",
]

#: Requests: start a race (JSON), advance it (control array), end; and to make a copy of the
#: process (empty, then a connection and a log for the copy by :func:`send_files`), to which
#: this process answers with the copy's process id and the copy, on its connection, with
#: nothing.
BEGIN, ACT, QUIT, FORK = b"B", b"A", b"Q", b"F"
#: Replies: the asked-for bytes, or a JSON object with ``type``, ``message``, ``traceback``.
OK, ERROR = b"O", b"E"

_HEADER = struct.Struct("<cI")
#: No message of ours comes near; a larger length is a sign of a broken stream.
_MAX_LENGTH = 1 << 28


def send(connection: socket.socket, kind: bytes, *frames: bytes) -> None:
    """Sends one message for each frame, or one empty message."""
    connection.sendall(b"".join(_HEADER.pack(kind, len(f)) + f for f in frames or (b"",)))


def receive(connection: socket.socket) -> tuple[bytes, bytes]:
    """Waits for one message and returns its kind and its bytes.

    Raises:
        EOFError: the other end is gone.
        TimeoutError: the socket's time-out passed.
    """
    kind, length = _HEADER.unpack(_receive_exactly(connection, _HEADER.size))
    if length > _MAX_LENGTH:
        raise EOFError(f"a message of {length} bytes makes no sense here")
    return kind, _receive_exactly(connection, length)


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


def _receive_exactly(connection: socket.socket, size: int) -> bytes:
    data = connection.recv(size) if size else b""
    if len(data) == size:
        return data
    parts = [data]
    missing = size - len(data)
    while data and missing:
        data = connection.recv(missing)
        parts.append(data)
        missing -= len(data)
    if missing:
        raise EOFError("the connection was closed")
    return b"".join(parts)
