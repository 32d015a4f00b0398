"""Files of arrays in the safetensors format, which contains no code."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import safetensors
import safetensors.numpy

from stkzoo._os import write_whole
from stkzoo._reading import check_file

#: Keys of the metadata: a text, and the names of arrays of texts, which are stored as code points.
_ABOUT, _TEXTS = "about", "texts"


def write_arrays(
    path: str | os.PathLike[str],
    arrays: Mapping[str, npt.NDArray[Any]],
    noun: str,
    about: str = "",
) -> None:
    """Writes arrays of numbers or texts to a file, atomically.

    Args:
        path: the file.
        arrays: the arrays by name.
        noun: name of the content in errors.
        about: a text for the file's metadata.

    Raises:
        ConfigError: the file cannot be written.
    """
    texts = [name for name, array in arrays.items() if array.dtype.kind == "U"]
    # safetensors writes the memory of an array, whatever the order of its axes.
    plain = {
        name: _code_points(array) if name in texts else np.asarray(array, order="C")
        for name, array in arrays.items()
    }
    content = safetensors.numpy.save(plain, {_ABOUT: about, _TEXTS: "\n".join(texts)})
    with write_whole(path, noun) as part:  # save_file would replace it by a file of another mode
        part.write_bytes(content)


def read_arrays(
    path: str | os.PathLike[str], max_bytes: int
) -> tuple[dict[str, npt.NDArray[Any]], str]:
    """Returns the arrays of a file by name, and the text in its metadata.

    Args:
        path: the file.
        max_bytes: maximum size [bytes].

    Raises:
        Unreadable: the file is too large or not a regular file.
        OSError: the file is missing or cannot be read.
        SafetensorError: the file is damaged.
    """
    check_file(path, max_bytes)
    with safetensors.safe_open(path, "numpy") as file:
        metadata = file.metadata() or {}
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
    for name in metadata.get(_TEXTS, "").splitlines():
        length = arrays[name].shape[-1]
        arrays[name] = arrays[name].view(f"U{length}").reshape(arrays[name].shape[:-1])
    return arrays, metadata.get(_ABOUT, "")


def _code_points(texts: npt.NDArray[np.str_]) -> npt.NDArray[np.uint32]:
    """Returns the code points of texts, ``(..., length)``."""
    length = texts.dtype.itemsize // np.dtype(np.uint32).itemsize
    return np.array(texts, order="C", ndmin=1).view(np.uint32).reshape(*texts.shape, length)
