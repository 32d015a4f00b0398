"""Weights as safetensors files, which contain arrays and no executable code."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping

import numpy as np
import safetensors.numpy

from stkzoo._os import write_whole
from stkzoo._reading import read_file, reading
from stkzoo.agents.planning import FloatArray
from stkzoo.errors import ConfigError

_MOST_BYTES = 1 << 26


def packed_weights(weights: Mapping[str, FloatArray]) -> bytes:
    """Returns the content of a file of float32 arrays."""
    arrays = {name: np.ascontiguousarray(array, "<f4") for name, array in weights.items()}
    return safetensors.numpy.save(arrays)


def save_weights(path: str | os.PathLike[str], weights: Mapping[str, FloatArray]) -> None:
    """Writes float32 arrays to a file atomically.

    Raises:
        ConfigError: the file cannot be written.
    """
    with write_whole(path, "the weights") as part:
        part.write_bytes(packed_weights(weights))


def load_weights(path: str | os.PathLike[str], digest: str | None = None) -> dict[str, FloatArray]:
    """Reads float32 arrays from a file.

    Args:
        path: path of the file.
        digest: expected SHA-256 of the file in hexadecimal; ``None`` skips the check.

    Raises:
        ConfigError: the file is missing or damaged, or has another digest.
    """
    with reading(f"the weights {str(path)!r} cannot be read", "a safetensors file of an agent"):
        data = read_file(path, _MOST_BYTES)
    actual = hashlib.sha256(data).hexdigest()
    if digest is not None and actual != digest:
        raise ConfigError(
            f"the weights {str(path)!r} are not those of the card: their SHA-256 is {actual}, "
            f"expected {digest}; get the file again"
        )
    with reading(f"{str(path)!r} is no safetensors file", "the weights of an agent"):
        weights = safetensors.numpy.load(data)
    types = sorted({str(array.dtype) for array in weights.values()})
    if types != ["float32"]:
        raise ConfigError(f"{str(path)!r} has numbers of {types}, expected float32")
    return weights
