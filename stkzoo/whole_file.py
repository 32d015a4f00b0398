"""Files that are there whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

__all__ = ["PARTS", "whole_file"]

#: What files that are being written are called.
PARTS = ".*.part"


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A file to write beside the one that is wanted, whose place it takes at the end.

    It is flushed to the disk first, so that whatever ends the program or the machine, the
    file is the new one, the old one, or none. After an error, nothing is left of it.

    Raises:
        OSError: it cannot be written, or it is a device, a pipe or a folder.
    """
    file = Path(path)
    if file.exists() and not file.is_file():  # a device, for one, would be replaced
        raise FileExistsError(errno.EEXIST, "it is there and is no plain file", str(file))
    folder = file.absolute().parent
    handle, name = tempfile.mkstemp(prefix=f".{file.name}.", suffix=".part", dir=folder)
    os.close(handle)
    part = Path(name)
    try:
        yield part
        part.chmod(0o644)
        _flush(part)
        part.replace(file)
    except BaseException:
        with contextlib.suppress(OSError):
            part.unlink()
        raise
    with contextlib.suppress(OSError):  # not everywhere can folders be flushed
        _flush(folder)


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
