"""Weights as safetensors files: a header of JSON, then the numbers; nothing in it can run.

The format is that of https://github.com/huggingface/safetensors: eight bytes with the header's
length, the header (name, type, shape and place of each array), the arrays' bytes.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from stkzoo._os import atomic_write
from stkzoo.agents.planning.arrays import FloatArray
from stkzoo.errors import ConfigError

_SIZE = struct.Struct("<Q")
_MOST_HEADER = 1 << 20
_MOST_BYTES = 1 << 26


def digest_of(path: str | os.PathLike[str]) -> str:
    """The SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def save_weights(path: str | os.PathLike[str], weights: Mapping[str, FloatArray]) -> None:
    """Writes arrays of float32 to a file, whole or not at all."""
    header: dict[str, object] = {}
    blocks: list[bytes] = []
    place = 0
    for name in sorted(weights):
        block = np.ascontiguousarray(weights[name], "<f4").tobytes()
        offsets = [place, place + len(block)]
        header[name] = {
            "dtype": "F32",
            "shape": list(weights[name].shape),
            "data_offsets": offsets,
        }
        blocks.append(block)
        place += len(block)
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    with atomic_write(path) as part:
        part.write_bytes(b"".join([_SIZE.pack(len(text)), text, *blocks]))


def load_weights(path: str | os.PathLike[str], digest: str | None = None) -> dict[str, FloatArray]:
    """Reads arrays of float32 from a file.

    Args:
        path: the file.
        digest: what :func:`digest_of` must give.

    Raises:
        ConfigError: the file is missing, broken, or not the one that the digest names.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise ConfigError(f"the weights {str(path)!r} cannot be read: {error}") from error
    found = hashlib.sha256(data).hexdigest()
    if digest is not None and found != digest:
        raise ConfigError(
            f"the weights {str(path)!r} are not those of the card: their SHA-256 is {found}, "
            f"expected {digest}; get the file again"
        )
    try:
        return _read(data)
    except (ValueError, KeyError, TypeError, AttributeError, struct.error) as error:
        raise ConfigError(
            f"{str(path)!r} is no safetensors file of float32 numbers: {error}"
        ) from error


def _read(data: bytes) -> dict[str, FloatArray]:
    (size,) = _SIZE.unpack_from(data)
    if size > min(_MOST_HEADER, len(data) - _SIZE.size) or len(data) > _MOST_BYTES:
        raise ValueError(f"its header has {size} bytes, the file {len(data)}")
    header = json.loads(data[_SIZE.size : _SIZE.size + size])
    body = memoryview(data)[_SIZE.size + size :]
    weights = {}
    for name, entry in header.items():
        if name == "__metadata__":
            continue
        shape = tuple(int(length) for length in entry["shape"])
        begin, end = (int(place) for place in entry["data_offsets"])
        if entry["dtype"] != "F32" or not 0 <= begin <= end <= len(body):
            raise ValueError(f"{name} is {entry}")
        if math.prod(shape) * 4 != end - begin:
            raise ValueError(f"{name} has {end - begin} bytes, but shape {shape}")
        weights[name] = np.frombuffer(body[begin:end], "<f4").reshape(shape).astype(np.float32)
    return weights
