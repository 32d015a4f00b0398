"""Encoding of plain data as messages."""

import contextlib
import enum
import time
import tracemalloc
from collections import OrderedDict

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from stkzoo import race_v0
from stkzoo.drivers import codec
from stkzoo.drivers.codec import LIMITS, Encoded, Limits, decode, encode
from stkzoo.errors import ProtocolError
from tests.oracle import messages as twin
from tests.support.bombs import BOMBS, array_bytes, bomb

DTYPES = (
    *(np.bool_, np.int8, np.int16, np.int32, np.int64),
    *(np.uint8, np.uint16, np.uint32, np.uint64, np.float16, np.float32, np.float64),
)
arrays = st.sampled_from(DTYPES).flatmap(
    lambda dtype: npst.arrays(dtype, npst.array_shapes(min_dims=0, max_dims=3, min_side=0))
)
leaves = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=False)
    | st.text()
    | st.binary()
    | arrays
    | st.sampled_from(DTYPES).flatmap(lambda dtype: npst.from_dtype(np.dtype(dtype)))
)
messages = st.recursive(
    leaves,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.lists(inner, max_size=4).map(tuple)
        | st.dictionaries(st.text(), inner, max_size=4)
    ),
    max_leaves=12,
)


def assert_same(one, other):
    assert type(one) is type(other)
    if isinstance(one, np.ndarray | np.generic):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    elif isinstance(one, dict):
        assert list(one) == list(other)
        for key, value in one.items():
            assert_same(value, other[key])
    elif isinstance(one, list | tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    else:
        assert one == other


@pytest.mark.slow
@settings(deadline=None)
@given(messages)
def test_a_message_survives_a_round_trip(message):
    assert_same(decode(encode(message)), message)


@settings(deadline=None, max_examples=500)
@given(st.binary(max_size=200))
def test_random_bytes_are_a_message_or_a_protocol_error(data):
    try:
        message = decode(data)
    except ProtocolError:
        return
    encode(message)


@settings(deadline=None, max_examples=300)
@given(messages, st.data())
def test_damaged_bytes_are_a_message_or_a_protocol_error(message, data):
    good = encode(message)
    place = data.draw(st.integers(0, len(good) - 1))
    bad = good[:place] + data.draw(st.binary(max_size=3)) + good[place + 1 :]
    try:
        again = decode(bad)
    except ProtocolError:
        return
    encode(again)


@pytest.mark.parametrize("view", ["full", "simple", "flattened", "flattened_discrete"])
def test_observations_of_views_survive_a_round_trip(view):
    with race_v0.parallel_env(num_kart=3, track="lighthouse", view=view) as env:
        observation = env.reset(seed=1)[0]["kart_0"]
    again = decode(encode(observation))
    assert env.observation_space("kart_0").contains(again)
    assert_same(again, observation)


def test_an_encoded_message_can_be_part_of_another():
    inner = {"a": (np.zeros(2), [1])}
    assert_same(decode(encode([1, (2, Encoded(encode(inner)))])), [1, (2, inner)])


def test_an_invalid_encoded_message_is_a_protocol_error():
    with pytest.raises(ProtocolError):
        decode(encode([Encoded(b"\xc1")]))


def test_decoded_arrays_are_writable():
    one, (first, second) = decode(encode([np.zeros(3), (np.zeros(2), np.zeros(2))]))
    one[0] = first[0] = second[1] = 7
    assert [one[0], first[0], second[1]] == [7, 7, 7]


class Color(enum.IntEnum):
    RED = 3


@pytest.mark.parametrize(
    ("value", "plain"),
    [(Color.RED, 3), (np.str_("a"), "a"), (OrderedDict(a=1), {"a": 1})],
    ids=str,
)
def test_subclasses_of_plain_types_become_plain(value, plain):
    assert_same(decode(encode([value])), [plain])


def looped():
    loop = []
    loop.append((loop,))
    return loop


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (object(), "has a object in it"),
        ([{1: 2}], "has the key 1"),
        (({1: 2},), "has the key 1"),
        (np.array([None]), "dtype object"),
        (np.array(["a"]), "dtype <U1"),
        (np.zeros(2, complex), "dtype complex128"),
        (np.zeros(2, ">f4"), "dtype >f4"),
        (2**64, "is not plain data"),
        ("\ud800", "is not plain data"),
        ({1, 2}, "has a set in it"),
        (looped(), "deeper than 16"),
        ([0] * 10_000, "10000 elements"),
        (np.zeros(1 << 21), "16777[0-9]+ bytes"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_unsupported_values_raise_a_protocol_error(value, text):
    with pytest.raises(ProtocolError, match=text):
        encode(value)


BAD = {
    "nothing": b"",
    "truncated": encode({"a": np.zeros(100)})[:-1],
    "trailing": encode(1) + b"\x00",
    "reserved byte": b"\xc1",
    "list longer than the message": b"\xdd\xff\xff\xff\xff",
    "dict longer than the message": b"\xdf\xff\xff\xff\xff",
    "text longer than the message": b"\xdb\xff\xff\xff\xff",
    "bytes longer than the message": b"\xc6\xff\xff\xff\xff",
    "no utf-8": b"\xa1\xff",
    "whole-number key": msgpack.packb({1: 2}),
    "bytes as key": msgpack.packb({b"a": 2}),
    "nested lists": b"\x91" * 900 + b"\xc0",
    "very nested lists": b"\x91" * 100_000 + b"\xc0",
    "nested tuples": encode(((((1,),),),)),
    "timestamp": msgpack.packb(msgpack.Timestamp(1, 1)),
    "unknown extension": msgpack.packb(msgpack.ExtType(9, b"abc")),
    "array too short": msgpack.packb(msgpack.ExtType(2, array_bytes(10, 3, content=b"1234"))),
    "array too long": msgpack.packb(msgpack.ExtType(2, array_bytes(10, 3, content=b"1" * 13))),
    "array without end": msgpack.packb(msgpack.ExtType(2, array_bytes(10, *[2**32 - 1] * 4))),
    "array of an unknown dtype": msgpack.packb(msgpack.ExtType(2, array_bytes(99, 1))),
    "array of many axes": msgpack.packb(msgpack.ExtType(2, array_bytes(1, *[1] * 40))),
    "array without header": msgpack.packb(msgpack.ExtType(2, b"")),
    "rows without end": msgpack.packb(msgpack.ExtType(4, array_bytes(1, 2**32 - 1, 0))),
    "rows without axis": msgpack.packb(msgpack.ExtType(4, array_bytes(1, content=b"1"))),
    "scalar too short": msgpack.packb(msgpack.ExtType(3, b"\x0b1234")),
    "tuple of no list": msgpack.packb(msgpack.ExtType(1, b"\x01")),
    "tuple with more": msgpack.packb(msgpack.ExtType(1, b"\x90\xc0")),
    "empty array of a long shape": msgpack.packb(msgpack.ExtType(2, array_bytes(1, 2**32 - 1, 0))),
}


@pytest.mark.parametrize("name", BAD)
def test_invalid_bytes_raise_a_protocol_error(name):
    with pytest.raises(ProtocolError, match=r"came|deeper|expected"):
        decode(BAD[name], Limits(max_depth=3))


def test_an_oversized_message_is_refused_before_it_is_decoded():
    with pytest.raises(ProtocolError, match="1001 bytes, expected at most 1000"):
        decode(b"\xc1" * 1001, Limits(max_bytes=1000))


def test_a_small_message_takes_little_memory():
    lists = b"\xdc\x20\x00" * 500  # each announces 8192 elements
    tracemalloc.start()
    for data in (*BAD.values(), lists + b"\xc0" * 10_000):
        with pytest.raises(ProtocolError):
            decode(data, Limits(max_depth=3))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 64 << 20


def peak_memory(data):
    """Returns the peak memory of decoding [bytes], and the message or ``None`` if it is refused.

    The peak is the lowest of up to three runs, because Python's table of interned strings may grow
    with any key of a dict.
    """
    peaks = []
    for _ in range(3):
        message = None
        tracemalloc.start()
        with contextlib.suppress(ProtocolError):
            message = decode(data)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        if peaks[-1] <= memory_bound(data):
            break
    return min(peaks), message


def memory_bound(data):
    return 16 * len(data) + (1 << 20 if len(data) < 1 << 16 else 0)


@pytest.fixture(params=["kernel", "twin"])
def either_kernel(request, monkeypatch):
    if request.param == "twin":
        monkeypatch.setattr(codec, "measure_message", twin.measure_message)


@pytest.mark.parametrize("name", BOMBS)
def test_decoding_takes_at_most_16_bytes_of_memory_per_byte(name):
    for length in (60, 1000, 65_000, 66_000, 1 << 18):
        data = bomb(name, length)
        assert peak_memory(data)[0] <= memory_bound(data)


@pytest.mark.usefixtures("either_kernel")
@pytest.mark.parametrize("name", BOMBS)
def test_decoding_an_8_mib_message_takes_little_cpu_time(name):
    data = bomb(name, LIMITS.max_bytes)
    begin = time.process_time()
    try:
        decode(data)
    except ProtocolError:
        assert len(data) <= LIMITS.max_bytes
    assert time.process_time() - begin < 3  # also in the reference implementation


@settings(deadline=None, max_examples=60)
@given(messages)
def test_the_measured_memory_is_an_upper_bound(message):
    data = encode([message] * 50)
    bounds = LIMITS.max_depth, LIMITS.max_length, LIMITS.max_elements, memory_bound(data)
    try:
        assert peak_memory(data)[0] <= codec.measure_message(data, bounds)
    except ValueError as error:
        assert "memory" in str(error)  # noqa: PT017 - the message may be accepted or refused


def test_the_observation_of_the_longest_track_survives_a_round_trip():
    with race_v0.parallel_env(num_kart=20, track="black_forest") as env:
        observation = env.reset(seed=1)[0]["kart_0"]
    data = encode([1, Encoded(encode(observation))])
    peak, message = peak_memory(data)
    assert peak <= memory_bound(data)
    assert_same(message, [1, observation])


def test_the_total_number_of_elements_is_limited():
    with pytest.raises(ProtocolError, match="too many elements"):
        decode(encode([[0] * 6, [0] * 6]), Limits(max_elements=13))
    assert decode(encode([[0] * 6, [0] * 6]), Limits(max_elements=14))


def test_booleans_are_0_or_1():
    odd = msgpack.packb(msgpack.ExtType(2, array_bytes(0, 2, content=b"\x02\x00")))
    assert decode(odd).view(np.uint8).tolist() == [1, 0]
