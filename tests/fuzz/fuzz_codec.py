"""Coverage-guided fuzzing of messages: ``pip install atheris && python -m tests.fuzz.fuzz_codec``.

Decoding must return a message or raise ``ProtocolError``; anything else ends the run. Accepts
libFuzzer's arguments, such as ``-runs=1000000`` or ``-max_total_time=60``.
"""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["stkzoo.drivers.codec"]):
    from stkzoo.drivers.codec import Limits, decode, encode

from stkzoo.errors import ProtocolError

_LIMITS = Limits(max_bytes=1 << 16)


def one_input(data: bytes) -> None:
    """Checks that a decoded message survives another round trip."""
    try:
        message = decode(data, _LIMITS)
    except ProtocolError:
        return
    again = encode(message)
    assert encode(decode(again)) == again


if __name__ == "__main__":
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()
