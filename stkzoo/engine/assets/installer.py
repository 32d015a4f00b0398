"""Installation of the game's data and of the headless pack."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from stkzoo._checks import check_name
from stkzoo.engine.assets.fetch import fetch_debian, fetch_upstream
from stkzoo.engine.assets.find import (
    CACHE_VARIABLE,
    DATADIR_VARIABLE,
    cache_folder,
    find_assets,
    own_folder,
)
from stkzoo.engine.assets.headless import build_headless, read_archive, write_archive
from stkzoo.engine.assets.staging import Progress, fresh_folder, lock, publish
from stkzoo.engine.assets.tree import Assets, load_assets
from stkzoo.errors import AssetError

#: Sources from which :func:`install` can download the data.
SOURCES = ("auto", "debian", "upstream")


def install(
    *,
    source: str = "auto",
    archive: Path | None = None,
    replace: bool = False,
    progress: Progress | None = None,
) -> Assets:
    """Installs the game's data: downloads it if it is missing, and builds the headless pack.

    If ``SUPERTUXKART_DATADIR`` names a folder, its data is used unchanged. Several programs can
    call this at the same time, and you can interrupt it at any time.

    Args:
        source: ``"debian"`` for the package of Debian and Ubuntu, ``"upstream"`` for the download
            of ``pystk2``, or ``"auto"`` for the first of these that works.
        archive: file with a headless pack to unpack; nothing is downloaded.
        replace: download and build data again even if it exists.
        progress: receives progress reports.

    Returns:
        The assets that headless races use.

    Raises:
        ConfigError: ``source`` is unknown.
        AssetError: the installation failed. No incomplete data remains.
    """
    check_name("source of the game's data", source, SOURCES)
    progress = progress or Progress()
    if archive is not None:
        if not archive.is_file():
            raise AssetError(f"there is no file {os.fspath(archive)!r}.")
        with _changing_the_cache(progress):
            _make(own_folder("headless"), lambda tree: read_archive(archive, tree, progress))
    elif os.environ.get(DATADIR_VARIABLE) and not replace:
        progress.note(f"{DATADIR_VARIABLE} names the data; there is nothing to download")
    elif replace or not _has_full_data() or _source_of_pack(replace) is not None:
        with _changing_the_cache(progress):
            _ensure_full_data(source, replace, progress)
            _ensure_pack(replace, progress)
    return find_assets()


def pack(
    *, output: Path | None = None, replace: bool = False, progress: Progress | None = None
) -> Path:
    """Builds the headless pack from the full data on this machine.

    Args:
        output: also write the pack to this ``.tar.xz`` file.
        replace: build the pack again even if it exists.
        progress: receives progress reports.

    Returns:
        ``output``, or by default the folder of the pack.

    Raises:
        AssetError: there is no full data, or the pack cannot be written.
    """
    progress = progress or Progress()
    if _source_of_pack(replace) is not None:
        with _changing_the_cache(progress):
            _ensure_pack(replace, progress)
    if output is None:
        return own_folder("headless")
    write_archive(own_folder("headless"), output, progress)
    return output


@contextlib.contextmanager
def _changing_the_cache(progress: Progress) -> Iterator[None]:
    """Locks stkzoo's cache, and converts each OSError of the block, such as a full disk.

    Raises:
        AssetError: files cannot be written.
    """
    try:
        with lock(cache_folder(), progress):
            yield
    except OSError as error:
        raise AssetError(
            f"the game's data cannot be written ({error}). Make room, or set {CACHE_VARIABLE} to a "
            "folder of your own with enough of it."
        ) from error


def _has_full_data() -> bool:
    with contextlib.suppress(AssetError):
        find_assets(graphics=True)
        return True
    return False


def _ensure_full_data(source: str, replace: bool, progress: Progress) -> None:
    if not replace and _has_full_data():
        return
    problems = []
    for name, fetch in (("debian", _fetch_package), ("upstream", fetch_upstream)):
        if source in ("auto", name):
            try:
                with fresh_folder(cache_folder()) as work:
                    fetch(work, progress)
            except AssetError as error:
                problems.append(f"{name}: {error}")
            else:
                return
    raise AssetError(
        "the game's data could not be downloaded.\n"
        + "\n".join(problems)
        + "\nWithout a network, copy a pack from another machine: there "
        "`stkzoo assets pack --output pack.tar.xz`, here `stkzoo assets install --from "
        "pack.tar.xz`."
    )


def _fetch_package(work: Path, progress: Progress) -> None:
    _make(own_folder("full"), lambda tree: fetch_debian(tree, work, progress))


def _make(folder: Path, fill: Callable[[Path], object]) -> None:
    """Makes a folder of stkzoo's data, which appears only when it is complete.

    Args:
        folder: the folder.
        fill: function that fills a temporary folder with the data.
    """
    with fresh_folder(cache_folder()) as tree:
        fill(tree)
        publish(tree, folder)


def _ensure_pack(replace: bool, progress: Progress) -> None:
    """Builds the headless pack if it is missing, of an older version, or to be replaced."""
    root = _source_of_pack(replace)
    if root is not None:
        _make(own_folder("headless"), lambda tree: build_headless(root, tree, progress))


def _source_of_pack(replace: bool) -> Path | None:
    """Returns the root of the data from which to build the headless pack; ``None`` to keep it.

    Raises:
        AssetError: there is neither a pack nor full data.
    """
    if not replace:
        with contextlib.suppress(AssetError):
            load_assets(own_folder("headless"), "headless pack")
            return None
    return find_assets(graphics=True).root
