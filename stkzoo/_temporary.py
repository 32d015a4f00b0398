"""Temporary folders, which the next program removes if this one is killed."""

from __future__ import annotations

import os
import secrets
import shutil
import stat
import subprocess
import tempfile
import threading
from contextlib import suppress
from multiprocessing.util import Finalize
from pathlib import Path

from stkzoo._locks import try_lock

_PREFIX = "stkzoo-run-"
#: The folder with all temporary folders of this program, by process id and place. A fork of this
#: program makes another one.
_program_folders: dict[tuple[int, str], Path] = {}
_creation = threading.Lock()


class TemporaryFolder:
    """A temporary folder. This class is a context manager.

    What :meth:`close` does not remove, such as after Ctrl-C, is removed when the program ends.

    Args:
        kind: purpose of the folder, which is part of its name.

    Attributes:
        path: the folder.
    """

    def __init__(self, purpose: str) -> None:
        self.path = Path(tempfile.mkdtemp(prefix=f"{purpose}-", dir=_program_folder()))

    def __enter__(self) -> TemporaryFolder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Removes the folder. Can be called again."""
        remove_tree(self.path)


def _program_folder() -> Path:
    """Returns the folder of this program. The first call also removes those of killed programs."""
    key = os.getpid(), tempfile.gettempdir()
    with _creation:
        if key not in _program_folders:
            remove_stale_folders()
            _program_folders[key] = _new_program_folder()
        return _program_folders[key]


def _new_program_folder() -> Path:
    """Creates a folder that is locked until this program ends or is killed."""
    folder = Path(tempfile.gettempdir(), _PREFIX + secrets.token_hex(8))
    # Registered first, because Ctrl-C may interrupt the next lines. Finalizers also run at the
    # end of a process of multiprocessing, and never in a fork of this one.
    Finalize(None, remove_marked, (folder,), exitpriority=0)
    folder.mkdir(mode=0o700)
    try_lock(os.open(folder, os.O_RDONLY), shared=True)  # it stays open
    _mark_of(folder).touch()  # last: from now on, other programs may remove it
    return folder


def make_marked_folder(parent: Path, prefix: str) -> Path:
    """Creates a temporary folder that :func:`remove_stale_folders` may remove.

    Args:
        parent: the folder in which to create it.
        prefix: start of its name.
    """
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
    _mark_of(folder).touch()
    return folder


def remove_stale_folders(parent: str | Path = "", prefix: str = _PREFIX) -> None:
    """Removes the folders of programs that were killed: those that are not locked.

    A folder counts only with the mark that this module makes in it, so that no folder of the user
    is removed, whatever its name.

    Args:
        parent: where to search; by default, the system's folder for temporary files.
        prefix: start of the folders' names.
    """
    for folder in Path(parent or tempfile.gettempdir()).glob(f"{prefix}*"):
        with suppress(OSError):
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                mark = _mark_of(folder).lstat()
                is_ours = stat.S_ISREG(mark.st_mode) and mark.st_uid == os.geteuid()
                # without locks, it may be in use
                if is_ours and try_lock(handle, if_unsupported=False):
                    remove_marked(folder)
            finally:
                os.close(handle)


def remove_marked(folder: Path) -> None:
    """Removes a folder with a mark, which is last: if this is interrupted, the mark remains."""
    with suppress(OSError):
        for inner in folder.iterdir():
            remove_tree(inner)
    remove_tree(folder)


def _mark_of(folder: Path) -> Path:
    """Returns the file that marks a folder, but no copy of it under another name."""
    return folder / f".made-by-stkzoo-as-{folder.name}"


def remove_tree(folder: Path) -> None:
    """Removes a folder and its content as far as possible; no content makes it raise.

    An agent may have nested more folders than Python can remove, or taken away permissions.

    Args:
        folder: the folder; if it does not exist, nothing happens.
    """
    with suppress(RecursionError):
        shutil.rmtree(folder, ignore_errors=True)
    if folder.is_dir() and not folder.is_symlink():
        for command in (["chmod", "-R", "u+rwx"], ["rm", "-rf"]):
            with suppress(OSError):  # slim systems may lack these programs
                subprocess.run([*command, "--", folder], stderr=subprocess.DEVNULL, check=False)  # noqa: S603 - fixed programs
