"""Bad calls of a C extension, made from valid ones.

``make sanitize`` runs them with extensions that stop the program at the first access outside their
arrays.
"""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stkzoo.engine.snapshot import HEADER_DTYPE

REFUSALS = (AttributeError, IndexError, MemoryError, OverflowError, TypeError, ValueError)
WHOLE = (0, 1, -1, 2, 7, 1000, -(2**31), 2**40)
REAL = (0.0, -1.0, 1e-30, 1e30, -1e30, float("nan"), float("inf"), float("-inf"))
OBJECTS = (None, (), {}, b"", "", 0.5, object(), np.zeros(0), np.zeros(3), np.float32(1))


def check_bad_calls(make, cases):
    """Calls ``make`` with bad arguments, which it must accept or refuse.

    Args:
        make: a class or a function.
        cases: valid calls: its arguments, and a method of the result with its arguments, or None.
    """

    @settings(
        max_examples=150,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.data())
    def call(data):
        args, kwargs, method, values = own(data.draw(st.sampled_from(cases), "case"))
        for _ in range(data.draw(st.integers(1, 2))):
            if args and (not values or data.draw(st.booleans())):
                args = with_bad_part(data.draw, args)
            elif values:
                values = with_bad_part(data.draw, values)
        try:
            made = make(*args, **kwargs)
            if method is not None:
                getattr(made, method)(*values)
        except REFUSALS:
            return

    call()


def check_lists_are_refused(call, args):
    """Calls with a list for each tuple of arrays, and returns the number of these tuples.

    A list can lose its arrays while the extension uses them.
    """
    groups = [n for n, part in enumerate(args) if holds_arrays(part)]
    for n in groups:
        with pytest.raises(TypeError, match="must be tuple, not list"):
            call(*args[:n], list(args[n]), *args[n + 1 :])
    return len(groups)


def holds_arrays(value):
    return isinstance(value, tuple) and any(isinstance(part, np.ndarray) for part in value)


def bad_array(draw, array):
    """Returns the array with another length, type, memory layout or content."""
    kind = draw(
        st.sampled_from(["shorter", "longer", "empty", "content", "type", "strided", "fixed"])
    )
    flat = array.reshape(-1)
    if kind == "shorter":
        return flat[:-1].copy()
    if kind == "longer":
        return np.concatenate([flat, flat[:1], np.zeros(1, array.dtype)])
    if kind == "empty":
        return np.zeros((0,) * max(array.ndim, 1), array.dtype)
    if kind == "type":
        dtype = draw(st.sampled_from(["f4", "f8", "i1", "i4", "i8", "?", ">f4", "O"]))
        with np.errstate(all="ignore"):
            return array.astype(dtype)
    if kind == "strided":
        return np.repeat(array, 2, axis=-1)[..., ::2] if array.ndim else array
    changed = array.copy()
    if kind == "fixed":
        changed.flags.writeable = False
        return changed
    values = [value for value in (*WHOLE, *REAL) if fits(value, array.dtype)]
    for _ in range(draw(st.integers(1, 3))):
        if changed.size:
            place = draw(st.integers(0, changed.size - 1))
            changed.reshape(-1)[place] = draw(st.sampled_from(values))
    return changed


def fits(value, dtype):
    if dtype.kind in "fO":
        return True
    is_whole = isinstance(value, int)
    return is_whole and (dtype.kind == "b" or np.iinfo(dtype).min <= value <= np.iinfo(dtype).max)


def bad_bytes(draw, data):
    """Returns a truncated snapshot, or one with other numbers in its records."""
    if draw(st.booleans()) or len(data) < HEADER_DTYPE.itemsize:
        size = draw(st.integers(0, len(data) + 8))
        return (data + bytes(8))[:size]
    changed = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        end = draw(st.sampled_from([len(data), min(len(data), HEADER_DTYPE.itemsize + 600)]))
        place = 4 * draw(st.integers(0, end // 4 - 1))
        number = draw(st.sampled_from([*REAL, *WHOLE[:-1]]))
        code = "<f" if isinstance(number, float) else "<i"
        changed[place : place + 4] = struct.pack(code, number)
    return bytes(changed)


def bad(draw, value):
    """Returns another value to replace an argument or a part of it."""
    if draw(st.integers(0, 9)) == 0:
        return draw(st.sampled_from(OBJECTS))
    if isinstance(value, np.ndarray):
        return bad_array(draw, value)
    if isinstance(value, bytes):
        return bad_bytes(draw, value)
    if isinstance(value, (tuple, list)) and value:
        return with_bad_part(draw, value)
    if isinstance(value, dict) and value:
        key = draw(st.sampled_from(list(value)))
        return {**value, key: bad(draw, value[key])}
    if isinstance(value, float):
        return draw(st.sampled_from(REAL))
    return draw(st.sampled_from(WHOLE) if isinstance(value, int) else st.sampled_from(OBJECTS))


def with_bad_part(draw, values):
    """Returns the sequence with one element replaced or removed."""
    place = draw(st.integers(0, len(values) - 1))
    parts = list(values)
    if draw(st.integers(0, 4)) == 0:
        del parts[place]
    else:
        parts[place] = bad(draw, parts[place])
    return tuple(parts) if isinstance(values, tuple) else parts


def own(value):
    """Returns the value with copies of its arrays, because the kernel may write into them."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if type(value) in (tuple, list):
        return type(value)(map(own, value))
    return {key: own(part) for key, part in value.items()} if isinstance(value, dict) else value
