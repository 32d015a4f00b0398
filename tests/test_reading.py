"""Untrusted files are read in bounded memory, and any damage raises one error."""

import io
import os
import struct
import tracemalloc
import zipfile
from dataclasses import dataclass
from typing import Annotated, Any

import pytest
from msgspec import Meta

from stkzoo._checks import check_whole
from stkzoo._reading import (
    Unreadable,
    load_json,
    open_zip,
    read_file,
    read_json,
    read_lines,
    read_text,
    read_zip,
    reading,
)
from stkzoo.errors import AssetError, ConfigError

MEGABYTE = 1 << 20


def peak_of(function, *arguments):
    """Returns the peak memory of a function that raises ``Unreadable`` [bytes]."""
    tracemalloc.start()
    try:
        with pytest.raises(Unreadable):
            function(*arguments)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def sparse(path, size=1 << 30):
    with path.open("wb") as file:
        file.truncate(size)
    return path


def load_any(path):
    return load_json(path, Any)


@pytest.mark.parametrize("read", [read_file, read_text, load_any])
def test_a_huge_file_is_refused_without_reading_it(tmp_path, read):
    assert peak_of(read, sparse(tmp_path / "huge")) < MEGABYTE


@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="there is no /proc")
def test_a_file_without_a_known_size_is_read_to_its_end():
    assert b"VmPeak" in read_file("/proc/self/status")


def test_reading_a_small_file_takes_little_memory(tmp_path):
    (tmp_path / "small").write_bytes(b"x")
    tracemalloc.start()
    assert read_file(tmp_path / "small", 1 << 30) == b"x"
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MEGABYTE


def test_a_pipe_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(Unreadable, match="not a regular file"):
        read_file(tmp_path / "pipe")


def test_text_in_another_encoding_is_refused(tmp_path):
    (tmp_path / "a").write_bytes("é".encode("latin-1"))
    with pytest.raises(Unreadable, match="byte 0 is not UTF-8 text"):
        read_text(tmp_path / "a")


@dataclass(frozen=True, slots=True)
class Wheel:
    size: Annotated[float, Meta(gt=0)]


@dataclass(frozen=True, slots=True)
class Cart:
    place: Annotated[int, Meta(ge=1, le=256)]
    wheels: tuple[Wheel, ...] = ()
    more: Any = None

    def __post_init__(self):
        check_whole("place", self.place, 1, 99)


def test_json_becomes_a_dataclass_and_unknown_entries_are_ignored():
    text = '{"place": 2, "wheels": [{"size": 1}], "more": {"a": [1, null]}, "unknown": [[]]}'
    assert read_json(text, Cart) == Cart(2, (Wheel(1.0),), {"a": [1, None]})


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "truncated"),
        ('{"place": 1, "more": ' + "[" * 100_000, "it is nested too deep"),
        ('{"place": 1, "more": NaN}', "JSON is malformed"),
        ('{"place": 1, "more": 1e999}', r"Number out of range - at `\$\.more`"),
        ('{"place": ' + "9" * 100_000 + "}", r"Integer value out of range - at `\$\.place`"),
        (b"\xff", "byte 0 is not UTF-8"),
        ('{"place": 0}', r"Expected `int` >= 1 - at `\$\.place`"),
        ('{"place": 100}', "place is 100, expected a whole number from 1 to 99"),
        ('{"place": 1, "wheels": [{"size": 1}, {}]}', r"`size` - at `\$\.wheels\[1\]`"),
    ],
)
def test_unusable_json_is_refused(text, problem):
    with pytest.raises(Unreadable, match=problem):
        read_json(text, Cart)


@pytest.mark.parametrize("part", ["[]", "{}", "[0]", '{"a":0}'])
def test_the_memory_of_json_is_bounded_by_its_size(part):
    text = "[" + f"{part}," * 100_000 + "0]"
    tracemalloc.start()
    try:
        read_json(text, Any)
        assert tracemalloc.get_traced_memory()[1] < 32 * len(text)
    finally:
        tracemalloc.stop()


def test_a_damaged_line_is_reported_with_its_number(tmp_path):
    (tmp_path / "log").write_text('{"a": 1}\n{"a"\n')
    with pytest.raises(Unreadable, match="in line 2: "):
        read_lines(tmp_path / "log", Any)


@pytest.mark.parametrize("rest", [b'{"a": 2, "b', b"\0\0\0", b'{"a": "\xc3'])
def test_an_incomplete_last_line_is_left_out(rest, tmp_path):
    (tmp_path / "log").write_bytes(b'{"a": 1}\n' + rest)
    assert read_lines(tmp_path / "log", Any) == [{"a": 1}]


# ---------------------------------------------------------------------- zips


def zip_of(path, members, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def test_a_member_above_its_limit_is_refused_without_unpacking_it(tmp_path):
    file = zip_of(tmp_path / "a.zip", {"a": bytes(64 * MEGABYTE)})
    assert peak_of(read_zip, file, {"a": 63 * MEGABYTE}) < 2 * MEGABYTE


def test_a_missing_member_is_named(tmp_path):
    with pytest.raises(Unreadable, match="it has no b"):
        read_zip(zip_of(tmp_path / "a.zip", {"a": b""}), {"b": 1})


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_unbounded_compression_is_refused(tmp_path, method):
    file = zip_of(tmp_path / "a.zip", {"a": b"a"}, method)
    with pytest.raises(Unreadable, match="unusual compression"):
        read_zip(file, {"a": 1})


def test_a_directory_of_a_million_members_is_refused_without_reading_it(tmp_path):
    entry = struct.pack("<4s42x", b"PK\1\2")
    count = 1_000_000
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 1, 1, count * len(entry), 0, 0)
    (tmp_path / "a.zip").write_bytes(entry * count + end)
    with pytest.raises(Unreadable, match="it has more than 10 files"):
        open_zip(tmp_path / "a.zip", 10, 1 << 30).__enter__()


@pytest.mark.slow
def test_members_that_share_their_bytes_are_refused(tmp_path):
    """A zip of 300 kB whose 100 members share the same 300 MB."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a", bytes(300 * MEGABYTE))
        archive.filelist *= 100
    (tmp_path / "a.zip").write_bytes(whole.getvalue())
    with pytest.raises(Unreadable, match="unpacked it is larger"):
        open_zip(tmp_path / "a.zip", 1000, 1 << 40).__enter__()


# ---------------------------------------------------------------------- the error


@pytest.mark.parametrize("error", [KeyError("a"), RecursionError("x"), OSError(2, "gone")])
def test_every_error_is_replaced_by_one_that_names_the_file(error):
    expected = pytest.raises(AssetError, match=r"^a\.json is bad \(.+\); expected a good one$")
    with expected, reading("a.json is bad", "a good one", AssetError):
        raise error


def test_a_long_reason_is_truncated():
    with pytest.raises(ConfigError) as caught, reading("a", "b"):
        raise ValueError("x" * 100_000)
    assert len(str(caught.value)) < 400


def test_a_zip_with_a_repeated_name_is_refused(tmp_path):
    file = tmp_path / "a.zip"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("a", b"1")
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr("a", b"2")
    with pytest.raises(Unreadable, match="it has the file 'a' more than once"):
        read_zip(file, {"a": 10})
