"""Temporary folders, which the next program removes if this one is killed."""

from __future__ import annotations

import os
import secrets
import shutil
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
    while True:
        folder = Path(tempfile.gettempdir(), _PREFIX + secrets.token_hex(8))
        # Registered first, because Ctrl-C may interrupt the next lines. Finalizers also run at the
        # end of a process of multiprocessing, and never in a fork of this one.
        Finalize(None, remove_tree, (folder,), exitpriority=0)
        folder.mkdir(mode=0o700)
        with suppress(FileNotFoundError):  # another program can remove it before it is locked
            lock = os.open(folder, os.O_RDONLY)
            if try_lock(lock, shared=True) and folder.exists():
                return folder
            os.close(lock)


def remove_stale_folders() -> None:
    """Removes the folders of programs that were killed: those that are not locked."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        with suppress(OSError):
            if folder.is_symlink() or folder.stat().st_uid != os.geteuid():
                continue
            folder.chmod(0o700)
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            try:
                if try_lock(handle, if_unsupported=False):  # without locks, it may be in use
                    remove_tree(folder)
            finally:
                os.close(handle)


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
