"""What an agent's files are, so that a batch is not continued with others."""

from __future__ import annotations

import hashlib
import importlib.util
import itertools
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from stkzoo.race.agents.files import find_files
from stkzoo.race.drivers import driver_names

__all__ = ["fingerprint"]

_MOST_FILES = 1000
_DIGEST_SIZE = 8
#: What running an agent may write beside its code.
_IGNORED_FOLDERS, _IGNORED_ENDINGS = ("__pycache__",), (".pyc", ".log")


def fingerprint(source: str) -> dict[str, str]:
    """A digest of each file of an agent, by its path in the agent's folder.

    Hidden files, logs and compiled modules are left out, and whatever comes after the first
    thousand. Drivers that come with stkzoo have no files: their version is stkzoo's.

    Args:
        source: as for :func:`~stkzoo.race.find_driver`, without a name behind it.
    """
    home = None if source in driver_names() else _home(source)
    if home is None:
        return {}
    files = itertools.islice(_files(home), _MOST_FILES)
    return {file.relative_to(home.parent).as_posix(): _digest(file) for file in files}


def _home(source: str) -> Path | None:
    files = find_files(source)
    if files is None or files.path is not None:
        return files.path if files else None
    top = source.partition(".")[0]
    for place in (*_places_of_module(top), top, f"{top}.py"):
        if place and Path(place).exists():
            return Path(place).resolve()
    return None


def _places_of_module(name: str) -> Sequence[str | None]:
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        spec = None
    if spec is None:
        return ()
    return list(spec.submodule_search_locations or ()) or [spec.origin]


def _files(home: Path) -> Iterator[Path]:
    if home.is_file():
        yield home
        return
    for folder, folders, names in os.walk(home):
        folders[:] = sorted(n for n in folders if n[0] != "." and n not in _IGNORED_FOLDERS)
        for name in sorted(names):
            file = Path(folder, name)
            if name[0] != "." and not name.endswith(_IGNORED_ENDINGS) and file.is_file():
                yield file


def _digest(file: Path) -> str:
    sum_so_far = hashlib.blake2b(digest_size=_DIGEST_SIZE)
    try:
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                sum_so_far.update(block)
    except OSError:
        return "unreadable"
    return sum_so_far.hexdigest()
