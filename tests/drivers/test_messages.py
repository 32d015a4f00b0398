"""Messages to and from agents: types, bounds, memory."""

import contextlib
import struct
import tracemalloc
from functools import partial

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from stkzoo import race_v0
from stkzoo.drivers.instances import Decision
from stkzoo.drivers.messages import (
    MAX_BYTES,
    Decided,
    Failed,
    Ready,
    Reply,
    decode,
    decode_observation,
    encode,
    encode_observation,
)
from stkzoo.errors import AgentTimeout, ProtocolError
from stkzoo.mdp.spaces import EXTRAS, kart_action_space
from stkzoo.race.remote.protocol import ClientMessage, ServerMessage
from stkzoo.views.registry import full_with

replies = msgspec.msgpack.Decoder(Reply)
DECODERS = {
    "observation": decode_observation,
    "reply": partial(decode, replies),
    "client": partial(decode, msgspec.msgpack.Decoder(ClientMessage)),
    "server": partial(decode, msgspec.msgpack.Decoder(ServerMessage)),
}
DTYPES = st.sampled_from(("<f4", "<f8", "|i1", "<i8", "|u1"))
arrays = npst.arrays(DTYPES, npst.array_shapes(min_dims=0, max_dims=4, min_side=0))
rows = npst.arrays(DTYPES, npst.array_shapes(min_dims=1, max_dims=2)).map(tuple)
observations = st.dictionaries(
    st.text(max_size=9).filter(lambda name: not name.startswith("paths_")),
    st.integers(-(2**63), 2**64 - 1) | st.text() | arrays | rows | st.just(()),
    max_size=9,
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
    elif isinstance(one, tuple):
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    else:
        assert one == other


@pytest.mark.slow
@settings(deadline=None)
@given(observations)
def test_an_observation_survives_a_round_trip(observation):
    assert_same(decode_observation(encode_observation(observation)), observation)


@pytest.mark.slow
def test_an_observation_of_a_race_survives_a_round_trip():
    view = full_with(frozenset(EXTRAS))
    with race_v0.parallel_env(num_kart=3, track="lighthouse", view=view) as env:
        observation = env.reset(seed=1)[0]["kart_0"]
        again = decode_observation(encode_observation(observation))
        assert env.observation_space("kart_0").contains(again)
    assert_same(again, observation)


def test_unused_track_segments_are_left_out():
    observation = {"paths_end": tuple(np.ones((5, 3))), "items": tuple(np.ones((5, 3)))}
    decoded = decode_observation(encode_observation(observation, paths_used=2))
    assert (len(decoded["paths_end"]), len(decoded["items"])) == (2, 5)


def test_decoded_arrays_are_writable():
    decoded = decode_observation(encode_observation({"a": np.zeros(3), "b": (np.zeros(2),)}))
    decoded["a"][0] = decoded["b"][0][0] = 7
    assert decoded["a"][0] == decoded["b"][0][0] == 7


def test_an_action_survives_a_round_trip():
    space = kart_action_space()
    space.seed(1)
    action = space.sample()
    message = Decided.of(Decision(action, 0.0, is_clipped=True))
    again = decode(replies, encode(message)).decision(0.0)
    assert space.contains(again.action)
    assert (again.action, again.is_clipped) == (action, True)


def test_an_error_survives_a_round_trip():
    failed = Failed.of(AgentTimeout("too late\x1b[2J", trace="line 1"))
    error = decode(replies, encode(failed)).error("kart_1", seconds=2.0)
    assert type(error) is AgentTimeout
    assert (str(error), error.key, error.trace, error.seconds) == (
        "too late",
        "kart_1",
        "line 1",
        2,
    )


@pytest.mark.parametrize(
    ("action", "text"),
    [
        ([0, 1.5, *[0] * 5], r"Expected `float` <= 1.0 - at `\$.action\[1\]`"),
        ([0, float("nan"), *[0] * 5], "Expected `float` >= -1.0"),
        ([0, [1.0], *[0] * 5], "Expected `float`, got `array`"),
        ([0, 0, -1, *[0] * 4], "Expected `float` >= 0.0"),
        ([0] * 8, "Expected `array` of length 7, got 8"),
    ],
    ids=str,
)
def test_an_invalid_action_is_refused(action, text):
    fields = {"type": "decided", "action": action, "is_clipped": False}
    with pytest.raises(ProtocolError, match=text):
        decode(replies, msgspec.msgpack.encode(fields))


def ext(code, *header, content=b""):
    """Returns an extension with an array's header: dtype, number of axes, lengths."""
    dtype, *shape = header
    return msgspec.msgpack.Ext(
        code, struct.pack(f"<BB{len(shape)}H", dtype, len(shape), *shape) + content
    )


INVALID = [
    (ext(1, 0, 3, content=b"1234"), "do not match its shape"),
    (ext(1, 9, 1), "unknown dtype"),
    (ext(1, 0, 1, 1, 1, 1, 1, content=b"1234"), "number of axes"),
    (msgspec.msgpack.Ext(2, b"\0\2\1"), "unknown dtype or number of axes"),
    (ext(2, 0, content=b"1234"), "neither an array nor rows"),
    (ext(7, 0, content=b"1234"), "neither an array nor rows"),
    (ext(1, 0, 9000, 0), "an axis of length 9000"),
    (None, "Expected `int | str | ext`"),
    ({"a": 1}, "Expected `int | str | ext`"),
]


def test_an_invalid_entry_of_an_observation_is_refused():
    for value, text in INVALID:
        with pytest.raises(ProtocolError) as caught:
            decode_observation(msgspec.msgpack.encode({"a": value}))
        assert text in str(caught.value)


@pytest.mark.parametrize("decoder", DECODERS)
@settings(deadline=None, max_examples=200)
@given(st.binary(max_size=200), st.data())
def test_random_and_damaged_bytes_are_a_message_or_a_protocol_error(decoder, noise, data):
    good = encode_observation({"a": np.zeros(2), "b": (np.zeros(3), np.zeros(3)), "c": 1})
    place = data.draw(st.integers(0, len(good) - 1))
    for bad in (noise, good[:place] + noise[:3] + good[place + 1 :]):
        with contextlib.suppress(ProtocolError):
            DECODERS[decoder](bad)


def test_an_oversized_message_is_refused_before_it_is_decoded():
    with pytest.raises(ProtocolError, match=f"of {MAX_BYTES + 1} bytes came, expected at most"):
        decode(replies, b"\xc1" * (MAX_BYTES + 1))
    with pytest.raises(ProtocolError, match="expected at most"):
        encode(Ready("x" * MAX_BYTES, None))


def test_a_number_of_more_than_64_bits_is_refused():
    with pytest.raises(ProtocolError, match="cannot be encoded"):
        encode(Ready("", 2**64))


def repeated(value):
    """Returns a function that fills a length with equal entries of an observation."""
    entry = msgspec.msgpack.encode(value) if not isinstance(value, bytes) else value

    def make(length):
        count = max(1, length // (len(entry) + 3))
        entries = b"".join(b"\xa2%02d" % (n % 100) + entry for n in range(count))
        return b"\xdf" + struct.pack(">I", count) + entries

    return make


def few(value):
    """Returns a function that puts as many entries as allowed into an observation."""
    return lambda length: repeated(value)(
        min(length, 60 * (len(msgspec.msgpack.encode(value)) + 3))
    )


#: The inputs that take most memory for their length, as functions of a length [bytes].
WORST = {
    "nested lists": lambda n: b"\x91" * n,
    "lists of lists": lambda n: b"\xdd" + struct.pack(">I", n) + b"\x90" * n,
    "a long list that is not there": lambda n: b"\xdd\x7f\xff\xff\xff" + bytes(n),
    "a long map that is not there": lambda n: b"\xdf\x7f\xff\xff\xff" + bytes(n),
    "empty extensions": repeated(ext(1, 0, 0)),
    "rows of nothing": few(ext(2, 2, 8192, 0)),
    "rows of one byte": few(ext(2, 2, 8192, 1, content=bytes(8192))),
    "rows of numbers": few(ext(2, 2, 8192, content=bytes(8192))),
    "a wide text": lambda n: msgspec.msgpack.encode({"a": "a" * n + "\U0001f40e"}),
    "bytes": lambda n: msgspec.msgpack.encode({"a": bytes(n)}),
    "unknown fields": lambda n: msgspec.msgpack.encode({"type": "bye", "a": [[]] * n}),
    "answers": lambda n: msgspec.msgpack.encode({"type": "decided", "action": [{}] * n}),
    "observations": lambda n: msgspec.msgpack.encode({"type": "act", "observation": bytes(n)}),
    "agents": lambda n: msgspec.msgpack.encode(
        {"type": "welcome", "protocol": 1, "stkzoo": "", "agents": [("", "", [])] * (n // 4)}
    ),
}


def peak_memory(decoder, data):
    """Returns the peak memory of decoding [bytes]: the least of three runs beside other threads."""
    peaks = []
    for _ in range(3):
        tracemalloc.start()
        with contextlib.suppress(ProtocolError):
            decoder(data)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    return min(peaks)


@pytest.mark.parametrize("name", WORST)
def test_decoding_takes_at_most_16_bytes_of_memory_per_byte(name):
    for length in (1000, 66_000, 1 << 20):
        data = WORST[name](length)
        for decoder in DECODERS.values():
            assert peak_memory(decoder, data) <= 16 * len(data) + (1 << 20)


def test_an_observation_with_too_many_rows_is_refused():
    data = WORST["rows of one byte"](1 << 20)
    with pytest.raises(ProtocolError, match="more rows than any track has"):
        decode_observation(data)


@pytest.mark.matrix
def test_the_largest_first_message_of_a_race_fits():
    with race_v0.parallel_env(
        num_kart=20, track="black_forest", view=full_with(frozenset(EXTRAS))
    ) as env:
        observation = encode_observation(env.reset(seed=1)[0]["kart_0"])
    assert MAX_BYTES / 4 < 20 * len(observation) < MAX_BYTES / 2
    assert peak_memory(decode_observation, observation) <= 16 * len(observation)
