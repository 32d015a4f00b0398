"""Folders that appear whole or not at all, one maker at a time."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from stkzoo.engine.assets.progress import Progress
from stkzoo.engine.assets.tree import MARKER
from stkzoo.errors import AssetError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

__all__ = [
    "check_space",
    "clear_leftovers",
    "discard",
    "fresh_folder",
    "link_or_copy",
    "lock",
    "publish",
    "staging_folder",
]

_PREFIX = ".stkzoo-"
_LOCK = ".stkzoo-lock"

#: Age after which a folder made outside the lock counts as left behind [s].
_STALE = 600.0


@contextmanager
def lock(cache: Path, progress: Progress) -> Iterator[None]:
    """Holds the cache for one process; others wait their turn.

    The operating system frees it when the process ends, however it ends. Where the
    system has no such locks, nothing is held.

    Raises:
        AssetError: the cache cannot be written.
    """
    try:
        cache.mkdir(parents=True, exist_ok=True)
        descriptor = _acquire(cache / _LOCK, progress)
    except OSError as error:
        raise AssetError(
            f"the cache folder {cache} cannot be written ({error}). Set STKZOO_CACHE to a "
            f"folder of your own."
        ) from error
    try:
        yield
    finally:
        os.close(descriptor)


def _acquire(path: Path, progress: Progress) -> int:
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        if fcntl is None:
            return descriptor
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            progress.note("another stkzoo works in the same cache: waiting for it to end")
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), path.stat()):
                return descriptor
        os.close(descriptor)  # the file was removed by the one we waited for


def fresh_folder(parent: Path, kind: str) -> Path:
    """A new empty folder in ``parent`` that nothing takes for finished work."""
    parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{kind}-", dir=parent))
    folder.chmod(0o755)
    return folder


@contextmanager
def staging_folder(parent: Path) -> Iterator[Path]:
    """A fresh folder to work in, removed at the end unless it was published."""
    folder = fresh_folder(parent, "staging")
    try:
        yield folder
    finally:
        discard(folder)


def publish(staging: Path, target: Path) -> None:
    """Moves a finished tree into its place, in one rename.

    Args:
        staging: a tree with its marker, on the same file system.
        target: its place; a tree of ours that stands there is replaced.

    Raises:
        AssetError: something that is not ours stands there.
    """
    if target.is_dir() and any(target.iterdir()):
        if not (target / MARKER).is_file():
            raise AssetError(
                f"{target} holds files that stkzoo did not make. Move them away, or set "
                f"STKZOO_CACHE to another folder."
            )
        old = fresh_folder(target.parent, "old")
        target.rename(old / "tree")
        staging.rename(target)
        discard(old)
        return
    if target.is_dir():
        target.rmdir()
    staging.rename(target)


def discard(folder: Path) -> None:
    """Removes a folder if it is there."""
    shutil.rmtree(folder, ignore_errors=True)


def clear_leftovers(cache: Path) -> None:
    """Removes what interrupted runs have left; call it with the lock held."""
    for folder in cache.glob(f"{_PREFIX}*-*"):
        unlocked = folder.name.startswith(f"{_PREFIX}overlay-")
        with suppress(FileNotFoundError):
            if not unlocked or time.time() - folder.stat().st_mtime > _STALE:
                discard(folder)


def link_or_copy(path: Path, goal: Path) -> None:
    """Gives a file a second name by a hard link, or copies it where that cannot be."""
    try:
        os.link(path.resolve(), goal)
    except OSError:
        shutil.copyfile(path, goal)


def check_space(folder: Path, needed: int, purpose: str) -> None:
    """Makes sure that the disk has room.

    Args:
        folder: where the files will go.
        needed: how much [bytes].
        purpose: what for, in the words of the message.

    Raises:
        AssetError: it has not.
    """
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise AssetError(
            f"{purpose} needs {needed / 1e6:.0f} MB, but {folder} has {free / 1e6:.0f} MB "
            f"free. Make room, or set STKZOO_CACHE to a folder on a larger disk."
        )
