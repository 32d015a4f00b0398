"""Mutations of bytes from a seeded source, for fuzzing without atheris."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence

__all__ = ["mutated"]

#: Byte sequences that often break parsers of JSON and zip files.
_TOKENS = (
    b"null", b"true", b"-1", b"0", b"1e999", b"NaN", b"9" * 30, b"9" * 5000, b'""', b"[]", b"{}",
    b"[" * 2000, b'{"a":' * 2000, b"\xff", b"\0", b"../", b"/", b"\\", b"PK\x01\x02", b'"\\ud800"',
    b"\xc7\xff\xff\xff\xff", b"\xdd\xff\xff\xff\xff",
)  # fmt: skip


def mutated(chance: random.Random, seeds: Sequence[bytes]) -> Iterator[bytes]:
    """Yields mutated copies of the seeds without end."""
    while True:
        data = bytearray(chance.choice(seeds))
        for _ in range(chance.randrange(1, 5)):
            _change(chance, data)
        yield bytes(data)


def _change(chance: random.Random, data: bytearray) -> None:
    first = chance.randrange(len(data) + 1)
    last = min(len(data), first + chance.choice((1, 1, 2, 4, 16, 64)))
    match chance.randrange(6):
        case 0:
            data[first:last] = chance.randbytes(last - first)
        case 1:
            del data[first:last]
        case 2:
            data[first:first] = data[first:last]
        case 3:
            data[first:last] = chance.choice(_TOKENS)
        case 4:
            data[first:first] = chance.choice(_TOKENS)
        case 5:
            del data[first:]
