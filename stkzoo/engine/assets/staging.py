"""Changes of the cache: progress reports, a lock, and folders that appear only when complete."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from stkzoo._locks import open_lock, try_lock
from stkzoo._temporary import make_marked_folder, remove_marked, remove_stale_folders
from stkzoo.engine.assets.tree import MARKER
from stkzoo.errors import AssetError


class Progress:
    """A receiver of progress reports that ignores them; the command line's subclass shows them.

    Long work is a sequence of stages. A stage starts with :meth:`begin` and ends when the next one
    starts.
    """

    def begin(self, stage: str, total: int | None = None) -> None:
        """Reports that a stage starts.

        Args:
            stage: short description of the stage.
            total: amount of work [bytes]; ``None`` if unknown.
        """

    def reach(self, done: int) -> None:
        """Reports that ``done`` bytes of the stage are complete."""

    def note(self, text: str) -> None:
        """Reports an event as one line of text."""


_PREFIX = ".stkzoo-"
_LOCK = ".stkzoo-lock"
_LOCK_POLL = 0.2  # [s]


@contextmanager
def lock(cache: Path, progress: Progress) -> Iterator[None]:
    """Locks the cache for one process, and removes the remains of interrupted processes.

    Other processes wait for the lock. The operating system releases it when the process ends, even
    after a crash. On a system without such locks, this locks nothing.

    Args:
        cache: folder of the cache.
        progress: receives a note if this process must wait.

    Raises:
        OSError: the cache is not writable.
    """
    cache.mkdir(parents=True, exist_ok=True)
    descriptor = open_lock(cache / _LOCK)
    try:
        if not try_lock(descriptor):
            progress.note("another stkzoo uses the same cache: waiting for it to end")
            while not try_lock(descriptor):
                time.sleep(_LOCK_POLL)
        remove_stale_folders(cache, _PREFIX)
        for folder in cache.glob(f"{_PREFIX}*"):
            with suppress(OSError):
                folder.rmdir()  # if empty: its program was killed before it made the mark
        yield
    finally:
        os.close(descriptor)


@contextmanager
def fresh_folder(parent: Path, purpose: str = "staging") -> Iterator[Path]:
    """Creates a temporary folder and removes it at the end, unless :func:`publish` moved it.

    It is in a folder with stkzoo's mark, which :func:`lock` removes if this program is killed.

    Args:
        parent: the folder in which to create it.
        purpose: part of its name.
    """
    parent.mkdir(parents=True, exist_ok=True)
    marked = make_marked_folder(parent, f"{_PREFIX}{purpose}-")
    try:
        folder = marked / "tree"
        folder.mkdir()
        folder.chmod(0o755)
        yield folder
    finally:
        remove_marked(marked)


def publish(staging: Path, target: Path) -> None:
    """Moves a finished tree to its target with one rename.

    Args:
        staging: a tree with its marker, on the same file system as ``target``.
        target: where the tree goes. An older tree made by stkzoo is replaced.

    Raises:
        AssetError: ``target`` contains files that stkzoo did not make.
    """
    with fresh_folder(target.parent, "old") as old:
        if target.is_dir() and any(target.iterdir()):
            if not (target / MARKER).is_file():
                raise AssetError(
                    f"{target} holds files that stkzoo did not make. Move them away, or set "
                    f"STKZOO_CACHE to another folder."
                )
            target.rename(old / "tree")
        staging.rename(target)


def link_or_copy(path: Path, goal: Path) -> None:
    """Creates a hard link to a file, or a copy where links are not possible.

    Args:
        path: the file.
        goal: path of the link or copy.
    """
    try:
        os.link(path.resolve(), goal)
    except OSError:
        shutil.copyfile(path, goal)
