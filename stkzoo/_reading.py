"""Readers of untrusted files, with bounded memory and one kind of error for any damage."""

from __future__ import annotations

import contextlib
import encodings.cp437  # noqa: F401 - zipfile imports it when it reads the first name of a file
import io
import os
import stat
import sys
import zipfile
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TypeVar

import msgspec

from stkzoo._os import read_blocks
from stkzoo._schema import plain_json
from stkzoo.errors import MAX_LINE, ConfigError, StkzooError, reason

T = TypeVar("T")

#: Default maximum size of a text or JSON file [bytes].
MAX_BYTES = 8 << 20

_MAX_REASON = 300
_MAX_ZIP = 64 << 20  # maximum size of a zip for :func:`read_zip` [bytes]
_MAX_LIST = 16 << 20  # maximum size of a zip's list of files [bytes]
_MEMBER = b"PK\1\2"  # start of a member's entry in a zip's list of files
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # other methods unpack without a bound
#: Maximum ratio of unpacked to packed size with deflate, if the members of a zip do not overlap;
#: and a size that is always allowed [bytes].
_MAX_RATIO, _SMALL = 1100, 1 << 20


class Unreadable(ValueError):
    """A file is damaged. :func:`reading` converts this to an error that names the file."""


@contextlib.contextmanager
def reading(
    what: str, expected: str, error_type: type[StkzooError] = ConfigError
) -> Iterator[None]:
    """Converts every error of a block that reads a file to an error for users.

    Args:
        what: start of the error text, such as ``"plan.json has no tournament plan"``.
        expected: the source of a valid file, or what to do.
        error_type: class of the error.

    Raises:
        StkzooError: the block raised an error; this one is an ``error_type``.
    """
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:  # damage causes many kinds of errors
        why = _why(error)
        line = f"{what} ({why}); expected {expected}"
        if len(line) > MAX_LINE:
            line = f"{what} ({why});\nexpected {expected}"
        raise error_type(line) from error


def _why(error: Exception) -> str:
    if isinstance(error, (OSError, StkzooError, Unreadable)):
        text = reason(error)
    elif isinstance(error, msgspec.MsgspecError):
        text = str(error)
    else:
        text = f"{type(error).__name__}: {error!s:.{_MAX_REASON}}"
    return text if len(text) <= _MAX_REASON else f"{text[:_MAX_REASON]}..."


# ---------------------------------------------------------------------- bytes, text and JSON


def read_file(path: str | os.PathLike[str], max_bytes: int = MAX_BYTES) -> bytes:
    """Returns the content of a file.

    Args:
        path: the file.
        max_bytes: maximum size [bytes].

    Raises:
        Unreadable: see :func:`check_file`.
        OSError: the file is missing or cannot be read.
    """
    file = Path(path)
    size = check_file(file, max_bytes)
    with file.open("rb") as stream:
        data = stream.read(size + 1)  # Python allocates as much memory as it is asked to read
        if len(data) > size:  # the file has grown, or its file system reports no size
            data += stream.read(max_bytes + 1 - len(data))
    if len(data) > max_bytes:
        raise Unreadable(f"it has more than {max_bytes:,} bytes")
    return data


def check_file(path: str | os.PathLike[str], max_bytes: int) -> int:
    """Checks the kind and size of a file before it is read, and returns its size [bytes].

    Args:
        path: the file.
        max_bytes: maximum size [bytes].

    Raises:
        Unreadable: the file is larger than ``max_bytes``, or not a regular file. A pipe, for
            example, would block.
        OSError: the file is missing.
    """
    about = Path(path).stat()
    if not stat.S_ISREG(about.st_mode):
        raise Unreadable("it is not a regular file")
    if about.st_size > max_bytes:
        raise Unreadable(f"it has {about.st_size:,} bytes, expected at most {max_bytes:,}")
    return about.st_size


def read_text(path: str | os.PathLike[str], max_bytes: int = MAX_BYTES) -> str:
    """Returns the text of a UTF-8 file.

    Args:
        path: the file.
        max_bytes: maximum size [bytes].

    Raises:
        Unreadable: the file is too large, not a regular file, or not UTF-8.
        OSError: the file is missing or cannot be read.
    """
    return _decoded(read_file(path, max_bytes))


def _decoded(data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise Unreadable(f"byte {error.start} is not UTF-8 text") from None


def read_json(text: str | bytes, schema: type[T], max_bytes: int = MAX_BYTES) -> T:
    """Returns the value of a JSON text.

    Objects become dataclasses. Entries that are not fields are ignored, because later versions may
    add entries. Control codes in texts are replaced.

    Args:
        text: the text, or its UTF-8 bytes.
        schema: type of the value, such as a dataclass whose annotations contain bounds.
        max_bytes: maximum length of the text [characters].

    Raises:
        Unreadable: the text is too long, not JSON, nested too deep, or has another type.
    """
    if isinstance(text, bytes):
        text = _decoded(text)
    if len(text) > max_bytes:
        raise Unreadable(f"it has {len(text):,} characters, expected at most {max_bytes:,}")
    try:
        return msgspec.json.decode(plain_json(text), type=schema)
    except RecursionError:
        raise Unreadable("it is nested too deep") from None
    except msgspec.DecodeError as error:
        raise Unreadable(str(error)) from None


def load_json(path: str | os.PathLike[str], schema: type[T], max_bytes: int = MAX_BYTES) -> T:
    """Returns the value of a JSON file; see :func:`read_file` and :func:`read_json`.

    Args:
        path: the file.
        schema: type of the value.
        max_bytes: maximum size [bytes].
    """
    return read_json(read_file(path, max_bytes), schema, max_bytes)


def read_lines(path: str | os.PathLike[str], schema: type[T], max_bytes: int = 64 << 20) -> list[T]:
    """Returns the values of the lines of a file of JSON lines.

    A last line without a line feed is left out: a power failure or a full disk can leave a part of
    a line.

    Args:
        path: the file.
        schema: type of the values.
        max_bytes: maximum size [bytes].

    Raises:
        Unreadable: the file is too large, or a line is not such a value.
        OSError: the file is missing or cannot be read.
    """
    *lines, _ = read_file(path, max_bytes).split(b"\n")
    return [_read_line(number, line, schema) for number, line in enumerate(lines, 1)]


def _read_line(number: int, line: bytes, schema: type[T]) -> T:
    try:
        return read_json(line, schema)
    except Unreadable as error:
        raise Unreadable(f"in line {number}: {error}") from None


# ---------------------------------------------------------------------- zips


@contextlib.contextmanager
def open_zip(
    path: str | os.PathLike[str], max_files: int, max_unpacked: int, max_bytes: int | None = None
) -> Iterator[zipfile.ZipFile]:
    """Opens a zip for reading after checking its list of members.

    Reading a member then takes no more memory than its declared size.

    Args:
        path: the file.
        max_files: maximum number of members.
        max_unpacked: maximum total size of the unpacked members [bytes].
        max_bytes: maximum size of the file [bytes]; by default, ``max_unpacked``.

    Raises:
        Unreadable: a limit is exceeded, a member is encrypted or has an unusual compression, or two
            members have the same name.
        Exception: the zip is damaged; zipfile and zlib raise errors of many classes.
    """
    file = Path(path)
    check_file(file, max_unpacked if max_bytes is None else max_bytes)
    # A list of files takes memory as soon as the zip is opened.
    if sum(block.count(_MEMBER) for block in read_blocks(file)) > max_files:
        raise Unreadable(f"it has more than {max_files} files")
    with _ZipFile(file.open("rb", 0)) as stream, zipfile.ZipFile(stream) as archive:
        stream.max_read = sys.maxsize
        members = archive.infolist()
        for member in members:
            _check_member(member)
        most = min(max_unpacked, _SMALL + _MAX_RATIO * file.stat().st_size)
        if sum(member.file_size for member in members) > most:
            raise Unreadable(f"unpacked it is larger than {most:,} bytes")
        if len(archive.NameToInfo) < len(members):  # readers disagree about which one counts
            names = Counter(member.filename for member in members)
            raise Unreadable(f"it has the file {names.most_common(1)[0][0][:60]!r} more than once")
        yield archive


class _ZipFile(io.BufferedReader):
    """An open zip, which refuses long reads until the list of its files has been read."""

    max_read = _MAX_LIST

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > self.max_read:
            raise Unreadable("its list of files is too long")
        return super().read(size)


def _check_member(member: zipfile.ZipInfo) -> None:
    name = f"its file {member.filename[:60]!r}"
    if member.flag_bits & 1:
        raise Unreadable(f"{name} is encrypted")
    if member.compress_type not in _METHODS:
        raise Unreadable(f"{name} has an unusual compression, expected deflate")


def read_zip(path: str | os.PathLike[str], limits: Mapping[str, int]) -> dict[str, bytes]:
    """Returns the contents of members of a zip, by name.

    Args:
        path: the file.
        limits: the members to read, with the maximum unpacked size of each [bytes].

    Raises: as :func:`open_zip`.
    """
    members = {}
    with open_zip(path, 10 * len(limits), sum(limits.values()), _MAX_ZIP) as archive:
        for name, limit in limits.items():
            if name not in archive.NameToInfo:
                raise Unreadable(f"it has no {name}")
            if archive.getinfo(name).file_size > limit:
                raise Unreadable(f"{name} has more than {limit:,} bytes")
            members[name] = archive.read(name)
    return members
