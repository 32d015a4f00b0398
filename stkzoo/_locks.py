"""Locks of files and folders, which the system releases when a program ends or is killed."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from stkzoo._os import PART_FILES, using_folder
from stkzoo.errors import ConfigError

#: Errors of file systems that have no locks.
_UNSUPPORTED = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP)
#: File by which a folder is locked.
LOCK = "lock"


def try_lock(descriptor: int, *, shared: bool = False, if_unsupported: bool = True) -> bool:
    """Locks an open file or folder for this process, without waiting.

    The system releases the lock when the process ends, even after a crash.

    Args:
        descriptor: descriptor of the file.
        shared: whether other processes can have shared locks at the same time.
        if_unsupported: result where the file system has no locks.

    Returns:
        Whether the file is locked; ``False`` if another process has locked it.

    Raises:
        OSError: the file cannot be locked for another reason.
    """
    try:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in _UNSUPPORTED:
            raise
        return if_unsupported
    return True


@contextlib.contextmanager
def locked_folder(folder: Path, noun: str) -> Iterator[None]:
    """Creates an ``--output`` folder if necessary, and locks it for the programs that use it.

    The incomplete files of killed programs in the folder and its subfolders are removed.

    Args:
        folder: the folder, or a link to it. It may be from somebody else, so links in it to other
            folders are refused: files would be written and removed there.
        noun: what the folder is for, such as ``"run"``.

    Raises:
        ConfigError: the folder cannot be used, contains a link to a folder, or another program has
            locked it.
    """
    with using_folder(folder, noun):
        folder.mkdir(parents=True, exist_ok=True)
        for entry in folder.iterdir():
            if entry.is_symlink() and entry.is_dir():
                raise ConfigError(
                    f"{entry} is a link to a folder, in which the {noun} would change files; "
                    "replace it by the folder itself, or remove it"
                )
        lock = open_lock(folder / LOCK)
    try:
        with using_folder(folder, noun):
            is_locked = try_lock(lock)
        if not is_locked:
            raise ConfigError(
                f"another program works on the {noun} in {folder}; wait until it ends, or choose "
                "another folder"
            )
        with using_folder(folder, noun):
            for part in (*folder.glob(PART_FILES), *folder.glob(f"*/{PART_FILES}")):
                part.unlink(missing_ok=True)
        yield
    finally:
        os.close(lock)


def open_lock(file: Path) -> int:
    """Opens a file to lock, which is created if needed and replaces a link; returns a descriptor.

    Raises:
        OSError: the file cannot be opened. A pipe does not block.
    """
    if file.is_symlink():
        file.unlink()
    return os.open(file, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
