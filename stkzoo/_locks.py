"""Locks of files and folders, which the system releases when a program ends or is killed."""

from __future__ import annotations

import contextlib
import errno
import fcntl
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
        folder: the folder.
        noun: what the folder is for, such as ``"run"``.

    Raises:
        ConfigError: the folder cannot be used, or another program has locked it.
    """
    with using_folder(folder, noun):
        folder.mkdir(parents=True, exist_ok=True)
        lock = open(folder / LOCK, "a")  # noqa: SIM115
    with lock:
        with using_folder(folder, noun):
            is_locked = try_lock(lock.fileno())
        if not is_locked:
            raise ConfigError(
                f"another program works on the {noun} in {folder}; wait until it ends, or choose "
                "another folder"
            )
        for pattern in (PART_FILES, f"*/{PART_FILES}"):
            for part in folder.glob(pattern):
                part.unlink(missing_ok=True)
        yield
