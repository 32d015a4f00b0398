"""Work on the cache: progress, one writer at a time, folders that appear complete."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from stkzoo._os import try_lock
from stkzoo.engine.assets.tree import MARKER
from stkzoo.errors import AssetError


class Progress:
    """Receives the progress of long work and ignores it; the command line draws bars.

    Work is a sequence of stages. Each begins with :meth:`begin` and ends when the
    next one begins.
    """

    def begin(self, stage: str, total: int | None = None) -> None:
        """A stage starts.

        Args:
            stage: a few words about it.
            total: amount of work [bytes], ``None`` if unknown.
        """

    def reach(self, done: int) -> None:
        """``done`` [bytes] of the stage are finished."""

    def note(self, text: str) -> None:
        """Something worth a line happened."""


_PREFIX = ".stkzoo-"
_LOCK = ".stkzoo-lock"
_LOCK_POLL = 0.2  # [s]

#: Age after which a folder made outside the lock counts as left behind [s].
_STALE = 600.0


@contextmanager
def lock(cache: Path, progress: Progress) -> Iterator[None]:
    """Locks the cache for one process, and removes what interrupted ones left; others wait.

    The operating system releases the lock when the process ends, however it ends. A system
    without such locks locks nothing.

    Raises:
        AssetError: the cache cannot be written.
    """
    try:
        cache.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(cache / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise AssetError(
            f"the cache folder {cache} cannot be written ({error}). Set STKZOO_CACHE to a "
            f"folder of your own."
        ) from error
    try:
        if not try_lock(descriptor):
            progress.note("another stkzoo uses the same cache: waiting for it to end")
            while not try_lock(descriptor):
                time.sleep(_LOCK_POLL)
        _clear_leftovers(cache)
        yield
    finally:
        os.close(descriptor)


@contextmanager
def fresh_folder(parent: Path, kind: str = "staging") -> Iterator[Path]:
    """An empty folder in ``parent``, removed at the end unless it was published.

    Its name marks it as unfinished.
    """
    parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{kind}-", dir=parent))
    folder.chmod(0o755)
    try:
        yield folder
    finally:
        discard(folder)


def publish(staging: Path, target: Path) -> None:
    """Moves a finished tree into its place, in one rename.

    Args:
        staging: a tree with its marker, on the same file system.
        target: its place; an older tree of stkzoo there is replaced.

    Raises:
        AssetError: files that stkzoo did not make are there.
    """
    if target.is_dir() and any(target.iterdir()):
        if not (target / MARKER).is_file():
            raise AssetError(
                f"{target} holds files that stkzoo did not make. Move them away, or set "
                f"STKZOO_CACHE to another folder."
            )
        with fresh_folder(target.parent, "old") as old:
            target.rename(old / "tree")
            staging.rename(target)
        return
    if target.is_dir():
        target.rmdir()
    staging.rename(target)


def discard(folder: Path) -> None:
    """Removes a folder if it is there."""
    shutil.rmtree(folder, ignore_errors=True)


def _clear_leftovers(cache: Path) -> None:
    for folder in cache.glob(f"{_PREFIX}*-*"):
        unlocked = folder.name.startswith(f"{_PREFIX}overlay-")
        with suppress(FileNotFoundError):
            if not unlocked or time.time() - folder.stat().st_mtime > _STALE:
                discard(folder)


def link_or_copy(path: Path, goal: Path) -> None:
    """Hard-links a file, or copies it where links are not possible."""
    try:
        os.link(path.resolve(), goal)
    except OSError:
        shutil.copyfile(path, goal)


def check_space(folder: Path, needed: int, purpose: str) -> None:
    """Checks that the disk has room.

    Args:
        folder: where the files will go.
        needed: how much [bytes].
        purpose: what for, in the words of the message.

    Raises:
        AssetError: it does not.
    """
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise AssetError(
            f"{purpose} needs {needed / 1e6:.0f} MB, but {folder} has {free / 1e6:.0f} MB "
            f"free. Make room, or set STKZOO_CACHE to a folder on a larger disk."
        )
