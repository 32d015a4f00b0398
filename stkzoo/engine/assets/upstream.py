"""The game's data by the download that ``pystk2`` brings along."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

from stkzoo.engine.assets.command import run
from stkzoo.engine.assets.places import DATADIR_VARIABLE, pystk2_cache_folder
from stkzoo.engine.assets.progress import Progress
from stkzoo.engine.assets.staging import check_space
from stkzoo.engine.assets.tree import ENGINE_DATA_VERSION, check_files
from stkzoo.errors import AssetError

__all__ = ["fetch_upstream"]

_ARCHIVE = f"SuperTuxKart-{ENGINE_DATA_VERSION}-src.tar.gz"

#: Room for the archive and what it holds [bytes].
_NEEDED = 1_800_000_000

#: A download that stands still for so long is given up [s].
_PATIENCE = 90.0

_PROGRAM = "import pystk2; pystk2.init(pystk2.GraphicsConfig.none())"


def fetch_upstream(work: Path, progress: Progress) -> Path:
    """Has ``pystk2`` fetch its data into its own cache, in a process of its own.

    Args:
        work: a folder to run in.
        progress: told about it.

    Returns:
        The tree's root.

    Raises:
        AssetError: it failed, or stood still for a minute and a half.
    """
    cache = pystk2_cache_folder()
    cache.mkdir(parents=True, exist_ok=True)
    check_space(cache, _NEEDED, "the game's data")
    progress.begin("downloading with pystk2")
    archive = cache / _ARCHIVE
    watch = _Watch(archive, cache / f"{_ARCHIVE}.tmp", progress)
    variables = {name: text for name, text in os.environ.items() if name != DATADIR_VARIABLE}
    try:
        run(
            [sys.executable, "-c", _PROGRAM],
            folder=work,
            watch=watch,
            name="the download of pystk2",
            last_lines=1,
            environment=variables,
        )
    except AssetError:
        archive.unlink(missing_ok=True)  # pystk2 would try the same broken file for ever
        raise
    root = cache / ENGINE_DATA_VERSION
    check_files(root)
    return root


class _Watch:
    """Follows the growing file; raises when nothing grows any more."""

    def __init__(self, archive: Path, growing: Path, progress: Progress) -> None:
        self._archive, self._growing, self._progress = archive, growing, progress
        self._size, self._since = -1, time.monotonic()
        self._unpacking = False

    def __call__(self) -> None:
        if self._archive.exists():
            if not self._unpacking:
                self._progress.begin("unpacking with pystk2")
            self._unpacking = True
            return
        size = self._growing.stat().st_size if self._growing.exists() else 0
        if size != self._size:
            self._size, self._since = size, time.monotonic()
            self._progress.reach(size)
        if not self._unpacking and time.monotonic() - self._since > _PATIENCE:
            raise AssetError(f"the download of pystk2 stood still for {_PATIENCE:.0f} s.")
