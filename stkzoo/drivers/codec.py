"""Encodes messages of plain data, for agents in other processes and on other machines.

A message is ``None``, ``bool``, ``int``, ``float``, ``str``, ``bytes``, a numpy array or
scalar of numbers or booleans, or a ``list``, ``tuple`` or ``dict`` (with ``str`` keys) of these.
Decoding returns an equal message. Lists and tuples stay distinct, and arrays are writable. The
format is msgpack with five extension types (``docs/reference/protocol.md``). Nothing is pickled.
Decoding never runs code from the message and raises only :class:`~stkzoo.errors.ProtocolError`.

Decoding uses at most 16 bytes of memory per byte of the message, plus 1 MiB for a message under
64 KiB. :func:`stkzoo.kernel.measure_message` checks these limits before decoding creates an object.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np
import numpy.typing as npt

from stkzoo.errors import ProtocolError, shortened
from stkzoo.kernel import join_rows, measure_message


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of one message.

    Attributes:
        max_bytes: maximum length [bytes].
        max_depth: maximum nesting depth of lists, tuples and dicts.
        max_length: maximum number of elements of one list, tuple or dict.
        max_elements: maximum number of elements of all lists, tuples and dicts together.
    """

    max_bytes: int = 8 << 20
    max_depth: int = 16
    max_length: int = 8192
    max_elements: int = 1 << 17


#: Default limits, far above the largest observation of any track.
LIMITS = Limits()

#: Memory limit of a message [bytes per byte]. The observation of the longest track needs 14.
_MEMORY_PER_BYTE = 16
#: A message below this length [bytes] may use this much additional memory [bytes].
_SHORT, _MEMORY_OF_SHORT = 1 << 16, 1 << 20


class Encoded(bytes):
    """An encoded message inside another message. Decoding the outer message decodes both.

    With this type, a program can forward a message without decoding it.
    """

    __slots__ = ()


# Codes of the msgpack extension types.
_TUPLE, _ARRAY, _SCALAR, _ROWS, _ENCODED = 1, 2, 3, 4, 5

_DTYPES = {
    code: np.dtype(name)
    for code, name in enumerate(
        ("|b1", "|i1", "<i2", "<i4", "<i8", "|u1", "<u2", "<u4", "<u8", "<f2", "<f4", "<f8")
    )
}
_CODES = {dtype: code for code, dtype in _DTYPES.items()}
_DTYPE_NAMES = ", ".join(dtype.name for dtype in _CODES)
_SCALARS = frozenset(dtype.type for dtype in _CODES)
_MAX_AXES = 8

#: Types without elements. Subclasses are converted to their base types.
_PLAIN = (type(None), bool, int, float, str, bytes, np.ndarray, *_SCALARS)
_LEAVES = frozenset(_PLAIN)
_BASES: tuple[Any, ...] = (str, int, float, bytes, list, dict)


def encode(message: object, limits: Limits = LIMITS) -> bytes:
    """Encodes a message.

    Subclasses of plain types, such as ``IntEnum``, ``OrderedDict`` and ``numpy.str_``, become
    their base types.

    Raises:
        ProtocolError: the message is not plain data or exceeds a limit.
    """
    try:
        _check(message, limits, 0)
        data = _pack(message)
    except (ValueError, TypeError, OverflowError) as error:
        raise ProtocolError(f"the message is not plain data: {error}") from error
    _check_size(data, limits)
    return data


def decode(data: bytes | bytearray | memoryview, limits: Limits = LIMITS) -> Any:
    """Decodes a message.

    Raises:
        ProtocolError: the bytes are not a message or exceed a limit.
    """
    _check_size(data, limits)
    memory = _MEMORY_PER_BYTE * len(data) + (_MEMORY_OF_SHORT if len(data) < _SHORT else 0)
    bounds = limits.max_depth, limits.max_length, limits.max_elements, memory
    try:
        measure_message(data, bounds)
        return _unpack(data)
    except Exception as error:  # msgpack and numpy report bad bytes in many ways
        raise ProtocolError(
            f"{len(data)} bytes came that are not a valid message: {str(error)[:200]}"
        ) from error


def _check_size(data: bytes | bytearray | memoryview, limits: Limits) -> None:
    if len(data) > limits.max_bytes:
        raise ProtocolError(f"a message of {len(data)} bytes, expected at most {limits.max_bytes}")


def _check(value: Any, limits: Limits, depth: int) -> None:
    """Rejects a message that is nested too deeply, has too many elements or is not plain data."""
    kind = type(value).__name__
    if not isinstance(value, (list, tuple, dict)):
        if not isinstance(value, _PLAIN):
            raise ProtocolError(
                f"a message has a {kind} in it, expected plain data: numbers, text, bytes, numpy "
                "arrays, and lists, tuples and dicts of these"
            )
        return
    if depth >= limits.max_depth:
        raise ProtocolError(f"a message is deeper than {limits.max_depth} levels")
    if len(value) > limits.max_length:
        raise ProtocolError(
            f"a {kind} of {len(value)} elements, expected at most {limits.max_length}"
        )
    if isinstance(value, dict):
        for key in value:
            if not isinstance(key, str):
                raise ProtocolError(f"a dict has the key {shortened(key, 100)}, expected text")
        value = value.values()
    if not _LEAVES.issuperset(map(type, value)):
        for item in value:
            _check(item, limits, depth + 1)


def _pack(value: object) -> bytes:
    data: bytes = msgpack.packb(value, default=_extended, strict_types=True)
    return data


def _extended(value: Any) -> Any:
    """Converts a value of a type that msgpack does not support."""
    if isinstance(value, tuple):
        return _as_rows(value) or msgpack.ExtType(_TUPLE, _pack(list(value)))
    if isinstance(value, np.ndarray):
        return msgpack.ExtType(_ARRAY, _array_bytes(value))
    if type(value) in _SCALARS:
        return msgpack.ExtType(_SCALAR, bytes((_CODES[value.dtype],)) + value.tobytes())
    if isinstance(value, Encoded):
        return msgpack.ExtType(_ENCODED, bytes(value))
    for kind in _BASES:
        if isinstance(value, kind):
            return kind(value)
    raise TypeError(f"it has a {type(value).__name__} in it")


def _as_rows(items: tuple[Any, ...]) -> msgpack.ExtType | None:
    """Joins arrays or scalars of one dtype and shape into one array; otherwise returns ``None``."""
    first = items[0] if len(items) > 1 else None
    if type(first) in _SCALARS and set(map(type, items)) == {type(first)}:
        return msgpack.ExtType(_ROWS, _array_bytes(np.array(items)))
    if type(first) is np.ndarray and 0 < first.ndim < _MAX_AXES and first.dtype in _CODES:
        data = join_rows(items)
        if data is not None:
            shape = len(items), *first.shape
            return msgpack.ExtType(_ROWS, _header(_CODES[first.dtype], shape) + data)
    return None


def _array_bytes(array: npt.NDArray[Any]) -> bytes:
    code = _CODES.get(array.dtype)
    if code is None:
        raise ProtocolError(f"an array of dtype {array.dtype}, expected one of {_DTYPE_NAMES}")
    if array.ndim > _MAX_AXES:
        raise ProtocolError(f"an array of {array.ndim} axes, expected at most {_MAX_AXES}")
    return _header(code, array.shape) + array.tobytes()


_HEADERS = [struct.Struct(f"<BB{axes}I") for axes in range(_MAX_AXES + 1)]


def _header(code: int, shape: tuple[int, ...]) -> bytes:
    try:
        return _HEADERS[len(shape)].pack(code, len(shape), *shape)
    except struct.error:
        raise ProtocolError(f"an array of shape {shape} is too large") from None


def _unpack(data: Any) -> Any:
    return msgpack.unpackb(data, ext_hook=_of_extension, strict_map_key=True)


def _of_extension(code: int, data: bytes) -> Any:
    if code == _ARRAY:
        return _array_of(data)
    if code == _ROWS:
        return tuple(_array_of(data))
    if code == _TUPLE:
        return tuple(_unpack(data))
    if code == _SCALAR:
        return _array_from(data[0], (), data, 1)[()]
    return _unpack(data)


def _array_of(data: bytes) -> npt.NDArray[Any]:
    layout = _HEADERS[data[1]]
    code, _, *shape = layout.unpack_from(data)
    return _array_from(code, shape, data, layout.size)


def _array_from(code: int, shape: Sequence[int], data: bytes, begin: int) -> npt.NDArray[Any]:
    """Returns a writable array of the elements that start at an offset."""
    view = np.ndarray(shape, _DTYPES[code], data, begin)
    # numpy treats a boolean byte other than 0 and 1 inconsistently.
    array: npt.NDArray[Any] = view.view(np.uint8) != 0 if code == 0 and shape else view.copy()
    return array
