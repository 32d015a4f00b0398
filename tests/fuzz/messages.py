"""Generators of malformed, truncated, oversized or mistyped messages."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import zmq

from stkzoo.drivers.codec import encode
from stkzoo.race.remote.protocol import VERSION, pack

_KINDS = (b"H", b"O", b"A", b"C", b"B", b"W", b"D", b"", b"OO", b"\x00")
_ODD = (None, True, -1, 2**63, 1.5, float("nan"), "", "x" * 300, b"\xff", [], {}, (), np.zeros(3))


def open_fields() -> dict[str, object]:
    """Returns the fields of a valid request for a seat."""
    return {
        "protocol": VERSION,
        "seat": 0,
        "driver": 0,
        "agent": "kart_0",
        "extras": [],
        "seed": 1,
        "action_timeout": 1.0,
        "start_timeout": 5.0,
    }


def bad_messages(chance: random.Random) -> Iterator[list[bytes]]:
    """Yields messages to a server without end; most of them are invalid, some only unusual."""
    opening = open_fields()
    bodies = (
        pack(**opening),
        pack(step=1, observations=[[0, encode({"velocity": np.zeros(3)})]]),
        pack(seats=[0]),
        pack(protocol=VERSION),
    )
    while True:
        kind = chance.choice(_KINDS)
        match chance.randrange(8):
            case 0:
                yield [kind, chance.randbytes(chance.randrange(100))]
            case 1:
                body = chance.choice(bodies)
                yield [kind, body[: chance.randrange(len(body))]]
            case 2:
                body = bytearray(chance.choice(bodies))
                for _ in range(chance.randrange(1, 8)):
                    body[chance.randrange(len(body))] = chance.randrange(256)
                yield [kind, bytes(body)]
            case 3:
                wrong = {chance.choice(list(opening)): chance.choice(_ODD)}
                yield [b"O", pack(**{**opening, **wrong})]
            case 4 if chance.random() < 0.5:
                yield [b"H", pack(protocol=chance.choice(_ODD))]
            case 4:
                yield [b"A", pack(step=chance.choice(_ODD), observations=chance.choice(_ODD))]
            case 5:
                yield [kind, b"\xdd\x00\x00\x20\x00" * chance.randrange(1, 600)]
            case 6:
                yield [kind, bytes(chance.randrange(1 << 15))]
            case 7:
                yield [chance.randbytes(chance.randrange(5)) for _ in range(chance.randrange(1, 6))]


def flood(socket: zmq.Socket[bytes], messages: Iterator[list[bytes]], count: int) -> None:
    """Sends ``count`` messages, and waits after each ten until the server has read them.

    The server may close the connection, which then opens again, but a message can be lost.
    """
    for number in range(count):
        socket.send_multipart(next(messages))
        if number % 10 == 9:
            while not _is_welcomed(socket):
                pass


def _is_welcomed(socket: zmq.Socket[bytes]) -> bool:
    """Greets a server; returns whether it answers within a second."""
    socket.send_multipart([b"H", pack(protocol=VERSION)])
    while socket.poll(1000):
        if socket.recv_multipart()[0] == b"W":
            return True
    return False


def resident_memory(process: int) -> int:
    """Returns the resident memory of a process without its children [bytes]."""
    pages = Path(f"/proc/{process}/statm").read_text().split()[1]
    return int(pages) * 4096
