"""Files of arrays are written atomically and read in bounded memory."""

import json
import struct

import numpy as np
import pytest
from safetensors import SafetensorError

from stkzoo._arrays import read_arrays, write_arrays
from stkzoo._reading import Unreadable

FLOAT = {"dtype": "F64", "shape": [1], "data_offsets": [0, 8]}


def test_arrays_survive_a_round_trip(tmp_path):
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array(3), "c": np.zeros((0, 3), "f4")}
    arrays["d"] = np.asfortranarray(arrays["a"])
    arrays["e"] = np.arange(10)[::2]
    arrays["f/g"] = np.array([["gnu", "süß", ""]])
    write_arrays(tmp_path / "a.safetensors", arrays, "the arrays", "text")
    found, about = read_arrays(tmp_path / "a.safetensors", 1000)
    assert (found.keys(), about) == (arrays.keys(), "text")
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
        assert (found[name].dtype, found[name].shape) == (array.dtype, array.shape)


@pytest.mark.parametrize(
    "header",
    [
        {"a": FLOAT | {"shape": [10**12]}},
        {"a": FLOAT | {"shape": [-1]}},
        {"a": FLOAT | {"data_offsets": [0, 16]}},
        {"a": FLOAT | {"dtype": "O"}},
        {"a": FLOAT, "b": FLOAT},
        [],
    ],
)
def test_arrays_that_do_not_match_their_header_are_refused(tmp_path, header):
    text = json.dumps(header).encode()
    (tmp_path / "a").write_bytes(struct.pack("<Q", len(text)) + text + bytes(8))
    with pytest.raises(SafetensorError):
        read_arrays(tmp_path / "a", 1000)


def test_a_large_file_is_refused_without_reading_it(tmp_path):
    (tmp_path / "a").write_bytes(bytes(1001))
    with pytest.raises(Unreadable, match="it has 1,001 bytes, expected at most 1,000"):
        read_arrays(tmp_path / "a", 1000)
