"""The reference implementation of ``messages.c``: measures a message before it is decoded."""

from __future__ import annotations

#: Sizes of objects, as in ``messages.c`` [bytes].
_POINTER, _LIST, _TUPLE, _EMPTY_DICT, _DICT, _ENTRY, _NUMBER = 8, 64, 48, 80, 256, 160, 32
_TEXT, _WIDE_TEXT, _BYTES, _ARRAY, _AXIS, _WORKING = 64, 80, 48, 112, 16, 1024

_MAX_AXES = 8
_ITEM_SIZES = (1, 1, 2, 4, 8, 1, 2, 4, 8, 2, 4, 8)

#: Number of bytes after the first byte, and memory of the object [bytes], for numbers, ``None``,
#: ``True`` and ``False``.
_PLAIN = {
    **dict.fromkeys((*range(0x80), *range(0xFB, 0x100), 0xC0, 0xC2, 0xC3), (0, 0)),
    **dict.fromkeys(range(0xE0, 0xFB), (0, _NUMBER)),
    0xCA: (4, _NUMBER),
    0xCB: (8, _NUMBER),
    0xCC: (1, 0),
    **{0xCC + power: (1 << power, _NUMBER) for power in (1, 2, 3)},
    **{0xD0 + power: (1 << power, _NUMBER) for power in (0, 1, 2, 3)},
}
#: Number of bytes of the length, which follows the first byte.
_TEXTS, _BLOBS = {0xD9: 1, 0xDA: 2, 0xDB: 4}, {0xC4: 1, 0xC5: 2, 0xC6: 4}
_LISTS, _DICTS = {0xDC: 2, 0xDD: 4}, {0xDE: 2, 0xDF: 4}
_EXTENSIONS = {0xC7: 1, 0xC8: 2, 0xC9: 4}


def measure_message(data: bytes | bytearray | memoryview, limits: tuple[int, int, int, int]) -> int:
    """Returns the peak memory of decoding a message [bytes].

    Args:
        data: the message.
        limits: largest depth, number of elements of one list, tuple or dict, number of elements in
            total, and memory [bytes].

    Raises:
        ValueError: the message is malformed or exceeds a limit.
    """
    scan = _Scan(bytes(data), limits)
    scan.scan_value(0)
    scan.check_end()
    return scan.peak


class _Scan:
    def __init__(self, data: bytes, limits: tuple[int, int, int, int]) -> None:
        self.data, self.at, self.end = data, 0, len(data)
        self.max_depth, self.max_length, self.max_elements, self.max_memory = limits
        self.elements = 0
        self.now = self.peak = _WORKING

    def hold(self, size: int) -> None:
        self.now += size
        self.peak = max(self.peak, self.now)
        if self.now > self.max_memory:
            raise ValueError("it takes too much memory for its length")

    def take(self, size: int) -> int:
        """Skips bytes and returns where they begin."""
        begin = self.at
        if size > self.end - begin:
            raise ValueError("it ends too early")
        self.at += size
        return begin

    def length_of(self, num_bytes: int) -> int:
        begin = self.take(num_bytes)
        return int.from_bytes(self.data[begin : begin + num_bytes], "big")

    def check_end(self) -> None:
        if self.at != self.end:
            raise ValueError("it goes on after its end")

    def check_depth(self, depth: int) -> None:
        if depth >= self.max_depth:
            raise ValueError("it is too deep")

    def count_elements(self, count: int) -> None:
        if count > self.max_length:
            raise ValueError("it has too many elements in one place")
        self.elements += count
        if self.elements > self.max_elements:
            raise ValueError("it has too many elements")

    def scan_value(self, depth: int) -> None:
        code = self.data[self.take(1)]
        if plain := _PLAIN.get(code):
            self.take(plain[0])
            self.hold(plain[1])
        elif code < 0x90:
            self.scan_dict(code & 15, depth)
        elif code < 0xA0:
            self.scan_list(code & 15, depth)
        elif code < 0xC0:
            self.scan_text(code & 31)
        elif code in _TEXTS:
            self.scan_text(self.length_of(_TEXTS[code]))
        elif code in _BLOBS:
            size = self.length_of(_BLOBS[code])
            self.take(size)
            self.hold(_BYTES + size)
        elif code in _LISTS:
            self.scan_list(self.length_of(_LISTS[code]), depth)
        elif code in _DICTS:
            self.scan_dict(self.length_of(_DICTS[code]), depth)
        elif code in _EXTENSIONS:
            self.scan_extension(self.length_of(_EXTENSIONS[code]), depth)
        elif 0xD4 <= code <= 0xD8:
            self.scan_extension(1 << (code - 0xD4), depth)
        else:
            raise ValueError("it has a reserved byte")

    def scan_text(self, size: int) -> None:
        begin = self.take(size)
        if not self.data[begin : begin + size].isascii():
            # Python copies the text decoded so far when it meets a wider character.
            self.hold(_WIDE_TEXT + 8 * size)
            self.now -= 4 * size
        elif size > 1:
            self.hold(_TEXT + size)

    def scan_list(self, count: int, depth: int) -> None:
        self.count_elements(count)
        self.hold(_LIST + _POINTER * count)
        self.check_depth(depth)
        for _ in range(count):
            self.scan_value(depth + 1)

    def scan_dict(self, count: int, depth: int) -> None:
        self.count_elements(count)
        self.hold(_DICT + _ENTRY * count if count else _EMPTY_DICT)
        self.check_depth(depth)
        for _ in range(count):
            code = self.data[self.take(1)]
            if 0xA0 <= code < 0xC0:
                self.scan_text(code & 31)
            elif code in _TEXTS:
                self.scan_text(self.length_of(_TEXTS[code]))
            else:
                raise ValueError("it has a dict with a key that is not text")
            self.scan_value(depth + 1)

    def scan_extension(self, size: int, depth: int) -> None:
        kind = self.data[self.take(1)]
        begin = self.take(size)
        self.hold(_BYTES + size)  # a copy of its content
        outer = self.at, self.end
        self.at, self.end = begin, begin + size
        if kind == 1:
            self.scan_tuple(depth)
        elif kind in (2, 4):
            self.scan_array(is_rows=kind == 4)
        elif kind == 3:
            self.scan_scalar()
        elif kind == 5:
            self.check_depth(depth)
            self.scan_value(depth + 1)
        else:
            raise ValueError("it has an unknown extension type")
        self.check_end()
        self.at, self.end = outer
        self.now -= _BYTES + size

    def scan_tuple(self, depth: int) -> None:
        """Scans a tuple. It is encoded as a list, which is freed after the tuple is made."""
        code = self.data[self.take(1)]
        if code in _LISTS:
            count = self.length_of(_LISTS[code])
        elif 0x90 <= code < 0xA0:
            count = code & 15
        else:
            raise ValueError("it has a tuple without a list of its items")
        self.scan_list(count, depth)
        self.hold(_TUPLE + _POINTER * count)
        self.now -= _LIST + _POINTER * count

    def scan_elements(self, dtype: int, axes: int, count: int) -> None:
        """Scans the elements of an array, which are the rest of its extension."""
        if dtype >= len(_ITEM_SIZES):
            raise ValueError("it has an array of an unknown dtype")
        size = self.end - self.at
        if count * _ITEM_SIZES[dtype] != size:
            raise ValueError("it has an array whose content does not fit its shape")
        self.take(size)
        held = _ARRAY + _AXIS * axes + size
        self.hold(held)
        if dtype == 0:  # decoding compares truth values, which makes another array
            self.hold(held)
            self.now -= held

    def scan_array(self, *, is_rows: bool) -> None:
        begin = self.take(2)
        dtype, axes = self.data[begin], self.data[begin + 1]
        if axes > _MAX_AXES:
            raise ValueError("it has an array of too many axes")
        begin = self.take(4 * axes)
        shape = [
            int.from_bytes(self.data[place : place + 4], "little")
            for place in range(begin, begin + 4 * axes, 4)
        ]
        count = 1
        for length in shape:
            count *= length or 1
        if 0 in shape:
            # The product of an empty array's other axes is limited like the length of a list.
            if count > self.max_length:
                raise ValueError("it has an empty array of a long shape")
            count = 0
        self.scan_elements(dtype, axes, count)
        if is_rows:
            if not shape:
                raise ValueError("it has rows without an axis")
            row = _POINTER + (_ARRAY + _AXIS * (axes - 2) if axes > 1 else _NUMBER)
            self.count_elements(shape[0])
            self.hold(_TUPLE + row * shape[0])

    def scan_scalar(self) -> None:
        dtype = self.data[self.take(1)]
        before = self.now
        self.scan_elements(dtype, 0, 1)
        self.now = before
        self.hold(_NUMBER)
