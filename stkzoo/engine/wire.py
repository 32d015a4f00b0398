"""Messages between a program and its engine processes.

A message consists of its tag (one byte), its number of frames (one byte), their lengths (four
bytes each), and the frames. A frame contains arrays in a fixed layout or JSON; nothing is pickled.
After sending a message, each end waits for a message from the other, so one read of a connection
returns at most one message, or its beginning.
"""

from __future__ import annotations

import json
import socket
import struct
import sys
import threading
import traceback
from collections.abc import Sequence

#: Requests to start a race (JSON) and to advance it (array of controls).
BEGIN, ACT = b"B", b"A"
#: Request to fork the process, with the descriptors of a connection and a log for the new process.
#: The reply, the id of the new process, comes over that connection.
FORK = b"F"
#: Requests to a fork server, with the process id of a child. END ends the child and replies with
#: its id and its wait status; DROP ends it without a reply.
END, DROP = b"X", b"D"
#: Request to the render process (:mod:`stkzoo.engine.render_process`) to move the karts and draw.
DRAW = b"P"
#: Replies: the requested bytes, or an error as a JSON object with ``type``, ``message`` and
#: ``traceback``.
OK, ERROR = b"O", b"E"

_HEADER = struct.Struct("<cB")
#: Maximum size of a message [bytes]. A larger size means that the stream is damaged.
_MAX_LENGTH = 1 << 28
#: Size of a read [bytes], larger than any packet, and than the messages of a step.
_ONE_READ = 1 << 18
#: Size of a write [bytes]. The system refuses larger packets than the send buffer of a socket.
_ONE_WRITE = 1 << 16


def pair() -> tuple[socket.socket, socket.socket]:
    """Returns both ends of a new connection within this machine.

    The connection is a packet socket, which is faster than a stream, where the system has these
    (Linux). Its ends block, whatever :func:`socket.setdefaulttimeout` says: an engine process
    expects this of the end that it gets.
    """
    socket_type = socket.SOCK_SEQPACKET if sys.platform == "linux" else socket.SOCK_STREAM
    ends = socket.socketpair(socket.AF_UNIX, socket_type)
    for end in ends:
        end.setblocking(True)
    return ends


def send(connection: socket.socket, tag: bytes, *frames: bytes, files: Sequence[int] = ()) -> None:
    """Sends one message.

    Args:
        connection: the socket.
        tag: tag of the message.
        *frames: frames of the message.
        files: descriptors of open files to send along, to a process on this machine.
    """
    head = struct.pack(f"<cB{len(frames)}I", tag, len(frames), *map(len, frames))
    message = b"".join([head, *frames])
    if files:
        socket.send_fds(connection, [message], files)
    else:
        for begin in range(0, len(message), _ONE_WRITE):
            connection.sendall(message[begin : begin + _ONE_WRITE])


def receive(connection: socket.socket) -> tuple[bytes, list[bytes]]:
    """Waits for one message and returns its tag and frames.

    Raises:
        EOFError: the other end is closed, or the message is invalid.
        TimeoutError: no message came within the socket's timeout.
    """
    room = _read_buffer.bytes
    return complete(connection, bytes(room[: connection.recv_into(room)]))


def receive_with_files(connection: socket.socket) -> tuple[bytes, list[bytes], list[int]]:
    """Waits for one message and returns its tag, frames and file descriptors.

    At most two descriptors are received. The caller must close them.

    Raises: as :func:`receive`.
    """
    data, files, _, _ = socket.recv_fds(connection, _ONE_READ, 2)
    return (*complete(connection, data), list(files))


def complete(connection: socket.socket, data: bytes) -> tuple[bytes, list[bytes]]:
    """Reads the rest of a message that begins with ``data``, and returns its tag and frames.

    Raises: as :func:`receive`.
    """
    data = _at_least(connection, data, _HEADER.size)
    tag, count = _HEADER.unpack_from(data)
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
    return tag, frames


def send_error(connection: socket.socket, error: Exception) -> None:
    """Replies with the error that is being handled.

    Args:
        connection: the socket.
        error: the error.
    """
    facts = {"type": type(error).__name__, "message": str(error)}
    text = json.dumps({**facts, "traceback": traceback.format_exc()})
    send(connection, ERROR, text.encode())


class _ReadBuffer(threading.local):
    """The read buffer of a thread, because a new buffer for each message is slower."""

    def __init__(self) -> None:
        self.bytes = memoryview(bytearray(_ONE_READ))


_read_buffer = _ReadBuffer()


def _at_least(connection: socket.socket, data: bytes, size: int) -> bytes:
    """Returns ``data`` extended to at least ``size`` bytes from the connection.

    Raises:
        EOFError: the other end is closed.
    """
    if len(data) >= size:
        return data
    whole = bytearray(data)
    while len(whole) < size:
        part = connection.recv(size - len(whole)) if data else b""
        if not part:
            raise EOFError("the connection was closed")
        whole += part
    return bytes(whole)
