"""Temporary directories, and the removal of folders whose content is not trusted."""

from __future__ import annotations

import atexit
import os
import secrets
import shutil
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from stkzoo._locks import try_lock
from stkzoo._os import OwnDescriptor

__all__ = ["LockedTemporaryDirectory", "remove_stale_directories", "remove_tree"]

_PREFIX = "stkzoo-run-"
#: Directories of this program; not those of a parent process.
_open: set[LockedTemporaryDirectory] = set()


class LockedTemporaryDirectory:
    """A temporary directory that is removed even if its program is killed.

    The directory is locked while the program runs, and the system releases the lock of a killed
    program. Whenever a new directory is created, all unlocked ones are removed. At the end of the
    program, the directories that are still open are removed, such as those whose removal Ctrl-C
    interrupted. This class is a context manager.

    Args:
        kind: purpose of the directory, which is part of its name.

    Attributes:
        path: the directory.
    """

    def __init__(self, kind: str) -> None:
        remove_stale_directories()
        self._lock: OwnDescriptor | None = None
        is_locked = False
        while not is_locked:  # another program can remove the directory before it is locked
            self.path = Path(tempfile.gettempdir(), f"{_PREFIX}{kind}-{secrets.token_hex(8)}")
            _open.add(self)  # first, because Ctrl-C may interrupt the next lines
            self.path.mkdir(mode=0o700)
            is_locked = sys.platform == "win32" or self._acquire()

    def __enter__(self) -> LockedTemporaryDirectory:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Removes the directory. Can be called again."""
        remove_tree(self.path)
        self.release()

    def release(self) -> None:
        """Releases the lock but keeps the directory."""
        _open.discard(self)
        lock, self._lock = self._lock, None
        if lock is not None:
            lock.close()

    def _acquire(self) -> bool:
        with suppress(FileNotFoundError):
            self._lock = OwnDescriptor(os.open(self.path, os.O_RDONLY))
            if try_lock(self._lock.fileno(), shared=True) and self.path.exists():
                return True
        self.release()
        return False


@atexit.register
def _close_all() -> None:
    while _open:
        _open.pop().close()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_open.clear)


def remove_stale_directories() -> None:
    """Removes the temporary directories of programs that were killed."""
    if sys.platform == "win32":  # no locks of folders
        return
    with suppress(OSError):
        for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
            with suppress(OSError):
                _remove_if_unlocked(folder)


def _remove_if_unlocked(folder: Path) -> None:
    handle = _open_folder(folder)
    try:
        is_own = os.fstat(handle).st_uid == os.geteuid()
        if is_own and try_lock(handle, if_unsupported=False):  # without locks, it may be in use
            remove_tree(folder)
    finally:
        os.close(handle)


def remove_tree(folder: Path) -> None:
    """Removes a folder and its content as far as possible; no content makes it raise.

    :func:`shutil.rmtree` recurses, so it fails if an agent nests thousands of folders. This
    function moves each nested folder to the top before it opens it, so neither the depth nor the
    length of a path is limited. It does not follow links, and removes folders without permissions.

    Args:
        folder: the folder; if it does not exist, nothing happens.
    """
    if sys.platform == "win32":  # no descriptors of folders; agents have no processes there
        shutil.rmtree(folder, ignore_errors=True)
        return
    with suppress(OSError):
        top = _open_folder(folder)
        try:
            waiting = _empty(top, top)
            while waiting:
                waiting += _remove(waiting.pop(), top)
        finally:
            os.close(top)
        folder.rmdir()


def _open_folder(path: str | Path, parent: int | None = None) -> int:
    """Opens a folder. If this user owns it, the user also gets all permissions for it.

    Args:
        path: the folder.
        parent: descriptor of the folder to which ``path`` is relative.

    Returns:
        A descriptor of the folder.

    Raises:
        OSError: the folder does not exist, cannot be opened, or is a link.
    """
    _permit(path, parent)
    return os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW, dir_fd=parent)


def _permit(path: str | Path, parent: int | None) -> None:
    if sys.platform != "linux":
        os.chmod(path, 0o700, dir_fd=parent, follow_symlinks=False)
        return
    # Linux has no chmod that does not follow links.
    handle = os.open(path, os.O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW, dir_fd=parent)
    try:
        if os.fstat(handle).st_uid == os.geteuid():
            os.chmod(f"/proc/self/fd/{handle}", 0o700)
    finally:
        os.close(handle)


def _remove(name: str, top: int) -> list[str]:
    """Removes a folder in the top folder; returns the new names of its nested folders there."""
    nested: list[str] = []
    with suppress(OSError):
        folder = _open_folder(name, top)
        try:
            nested = _empty(folder, top)
        finally:
            os.close(folder)
        os.rmdir(name, dir_fd=top)
    return nested


def _empty(folder: int, top: int) -> list[str]:
    """Removes the files of a folder and moves its nested folders; returns their new names."""
    nested = []
    with os.scandir(folder) as entries:
        found = list(entries)
    for entry in found:
        with suppress(OSError):
            if not entry.is_dir(follow_symlinks=False):
                os.unlink(entry.name, dir_fd=folder)
                continue
            _permit(entry.name, folder)  # a folder that is not writable cannot be moved
            name = secrets.token_hex()  # unknown to the agent, so it does not exist
            os.rename(entry.name, name, src_dir_fd=folder, dst_dir_fd=top)
            nested.append(name)
    return nested
