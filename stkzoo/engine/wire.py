"""Messages between a program and its engine processes.

A message is a kind (one byte), a length and that many bytes. Nothing is pickled:
the bytes are arrays by a fixed layout, or JSON.
"""

from __future__ import annotations

import socket
import struct

__all__ = ["ACT", "BEGIN", "ERROR", "OK", "QUIT", "receive", "send"]

#: Requests: start a race (JSON), advance it (control array), end.
BEGIN, ACT, QUIT = b"B", b"A", b"Q"
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
