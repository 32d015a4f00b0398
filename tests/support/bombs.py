"""Small messages that take much memory or time to decode."""

from __future__ import annotations

import struct
from collections.abc import Callable

import msgpack

__all__ = ["BOMBS", "array_bytes", "bomb", "extension", "list_of"]

TUPLE, ARRAY, SCALAR, ROWS, ENCODED = 1, 2, 3, 4, 5

#: Maximum number of elements in a list.
_LONGEST = 8192


def array_bytes(code: int, *shape: int, content: bytes = b"") -> bytes:
    """Returns the content of an array's extension."""
    return struct.pack(f"<BB{len(shape)}I", code, len(shape), *shape) + content


def extension(kind: int, content: bytes) -> bytes:
    """Returns a value of an extension type."""
    data: bytes = msgpack.packb(msgpack.ExtType(kind, content))
    return data


def list_of(items: list[bytes]) -> bytes:
    """Returns a list of encoded values."""
    return b"\xdd" + struct.pack(">I", len(items)) + b"".join(items)


def _repeated(value: bytes) -> Callable[[int], bytes]:
    """Returns a function that fills a length with equal values, in lists within a list."""

    def make(length: int) -> bytes:
        count = max(1, length // len(value))
        sizes = [min(_LONGEST, count - begin) for begin in range(0, count, _LONGEST)]
        return list_of([list_of([value] * size) for size in sizes])

    return make


def _dicts(length: int) -> bytes:
    """Returns dicts with as many short keys as possible."""
    items = b"".join(b"\xa3%03x\xc0" % (number & 0xFFF) for number in range(4096))
    one = b"\xde" + struct.pack(">H", 4096) + items
    return list_of([one] * max(1, length // len(one)))


def _keys(length: int) -> bytes:
    """Returns a dict with long keys."""
    count = max(1, min(_LONGEST, length // 1004))
    keys = (b"\xda" + struct.pack(">H", 1000) + b"%01000d" % n + b"\xc0" for n in range(count))
    return b"\xde" + struct.pack(">H", count) + b"".join(keys)


def _nested(kind: int) -> Callable[[int], bytes]:
    """Returns a function that nests extensions, which are copied at each level."""

    def make(length: int) -> bytes:
        data = b"\xc6" + struct.pack(">I", length) + bytes(length)
        for _ in range(12):
            data = extension(kind, list_of([data]) if kind == TUPLE else data)
        return data

    return make


def _text(end: str) -> Callable[[int], bytes]:
    def make(length: int) -> bytes:
        text = b"a" * length + end.encode()
        return b"\xdb" + struct.pack(">I", len(text)) + text

    return make


def _deep(opening: bytes) -> Callable[[int], bytes]:
    return lambda length: opening * (length // len(opening)) + b"\xc0"


#: Functions that make a message of about a given length [bytes].
BOMBS: dict[str, Callable[[int], bytes]] = {
    "rows of nothing": _repeated(extension(ROWS, array_bytes(1, 8192, 0))),
    "rows of little": _repeated(extension(ROWS, array_bytes(1, 8192, 1, content=bytes(8192)))),
    "rows of scalars": _repeated(extension(ROWS, array_bytes(1, 8192, content=bytes(8192)))),
    "rows of many axes": _repeated(extension(ROWS, array_bytes(1, 8192, *[1] * 6, 0))),
    "empty lists": _repeated(b"\x90"),
    "empty dicts": _repeated(b"\x80"),
    "empty tuples": _repeated(extension(TUPLE, b"\x90")),
    "tuples in tuples": _repeated(extension(TUPLE, b"\x91" + extension(TUPLE, b"\x91\xc0"))),
    "encoded values": _repeated(extension(ENCODED, b"\xc0")),
    "lists of one": _repeated(b"\x91\x91\x91\x91\xc0"),
    "small numbers": _repeated(b"\x01"),
    "large numbers": _repeated(b"\xcd\xff\xff"),
    "negative numbers": _repeated(b"\xe0"),
    "floats": _repeated(b"\xcb" + bytes(8)),
    "scalars": _repeated(extension(SCALAR, b"\x01\x07")),
    "arrays of one number": _repeated(extension(ARRAY, array_bytes(1, content=b"\x07"))),
    "empty arrays": _repeated(extension(ARRAY, array_bytes(1, 0))),
    "truth values": lambda n: extension(ARRAY, array_bytes(0, n, content=bytes(n))),
    "short texts": _repeated(b"\xa2ab"),
    "short bytes": _repeated(b"\xc4\x02ab"),
    "a wide text": _text("\U0001f40e"),
    "a text that widens twice": _text("\u20ac\U0001f40e"),
    "wide texts": _repeated(b"\xa5a\xf0\x9f\x90\x8e"),
    "dicts": _dicts,
    "dicts of one": _repeated(b"\x81\xa1a\xc0"),
    "long keys": _keys,
    "encoded in encoded": _nested(ENCODED),
    "copies of tuples": _nested(TUPLE),
    "deep lists": _deep(b"\x91"),
    "deep dicts": _deep(b"\x81\xa1a"),
    "deep extensions": _deep(b"\xc9\x00\x7f\xff\xff\x05"),
    "lists that claim to be long": _deep(b"\xdc\x20\x00"),
    "dicts that claim to be long": _deep(b"\xde\x20\x00"),
}


def bomb(name: str, length: int) -> bytes:
    """Returns a bomb of about ``length`` bytes; not longer if its parts are short."""
    data = BOMBS[name](length)
    if len(data) > length:
        data = BOMBS[name](max(1, 2 * length - len(data) - 64))
    return data
