"""Temporary folders that do not pile up, however a program ends.

A folder is locked for as long as its program lives; the system frees the lock at its end.
Whoever makes the next one removes those that are locked no more.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import stat
import tempfile
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

__all__ = ["ScratchFolder", "sweep"]

_PREFIX = "stkzoo-run-"


class ScratchFolder:
    """A new temporary folder. A context manager.

    Args:
        kind: what it is for; part of its name.

    Attributes:
        path: the folder.
    """

    def __init__(self, kind: str) -> None:
        sweep()
        self._lock: int | None = None
        is_held = False
        while not is_held:  # until no other program's sweep() comes between
            self.path = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{kind}-"))
            is_held = fcntl is None or self._hold()

    def __enter__(self) -> ScratchFolder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Removes the folder; may be called again."""
        shutil.rmtree(self.path, ignore_errors=True)
        self.let_go()

    def let_go(self) -> None:
        """Leaves the folder to others."""
        lock, self._lock = self._lock, None
        if lock is not None:
            os.close(lock)

    def _hold(self) -> bool:
        with contextlib.suppress(FileNotFoundError, BlockingIOError):
            self._lock = os.open(self.path, os.O_RDONLY)
            fcntl.flock(self._lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            if self.path.exists():
                return True
        self.let_go()
        return False


def sweep() -> None:
    """Removes the folders of programs that have been killed."""
    if fcntl is None:
        return
    with contextlib.suppress(OSError):
        for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
            with contextlib.suppress(OSError):
                _remove_if_left(folder)


def _remove_if_left(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        about = os.fstat(handle)
        if about.st_uid == os.geteuid() and stat.S_ISDIR(about.st_mode):
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(folder, ignore_errors=True)
    finally:
        os.close(handle)
