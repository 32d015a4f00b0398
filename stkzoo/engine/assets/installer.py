"""Installing the game's data, building the headless pack, and removing both."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path

from stkzoo.engine.assets.fetch import fetch_debian, fetch_upstream
from stkzoo.engine.assets.find import (
    DATADIR_VARIABLE,
    cache_folder,
    find_assets,
    own_folder,
)
from stkzoo.engine.assets.headless import build_headless, read_archive, write_archive
from stkzoo.engine.assets.scenes import SCENES_VERSION
from stkzoo.engine.assets.staging import (
    Progress,
    discard,
    fresh_folder,
    lock,
    publish,
)
from stkzoo.engine.assets.tree import MARKER, Assets, load_assets
from stkzoo.errors import AssetError, unknown_name

#: Where :func:`install` can get the data.
SOURCES = ("auto", "debian", "upstream")


def install(
    *,
    source: str = "auto",
    archive: Path | None = None,
    replace: bool = False,
    progress: Progress | None = None,
) -> Assets:
    """Makes the game's data usable: keeps what is there and downloads the rest.

    It ends with building the headless pack. Data that ``SUPERTUXKART_DATADIR`` names is
    used as it is. You may call it from several programs at once and interrupt it at any
    moment.

    Args:
        source: ``"debian"``: from the package of Debian and Ubuntu; ``"upstream"``: by
            the download of ``pystk2``; ``"auto"``: whichever works.
        archive: unpack the headless pack from this file and download nothing.
        replace: download and build again what is already there.
        progress: receives the progress.

    Returns:
        What a headless race will use.

    Raises:
        ConfigError: an unknown ``source``.
        AssetError: it failed; nothing incomplete is left in place.
    """
    if source not in SOURCES:
        raise unknown_name("source of the game's data", source, SOURCES)
    progress = progress or Progress()
    with lock(cache_folder(), progress):
        if archive is not None:
            if not archive.is_file():
                raise AssetError(f"there is no file {os.fspath(archive)!r}.")
            _make(own_folder("headless"), lambda tree: read_archive(archive, tree, progress))
        elif os.environ.get(DATADIR_VARIABLE) and not replace:
            progress.note(f"{DATADIR_VARIABLE} names the data; there is nothing to download")
        else:
            full = _full_assets(source, replace, progress)
            _ensure_pack(full, replace, progress)
    return find_assets()


def pack(
    *, output: Path | None = None, replace: bool = False, progress: Progress | None = None
) -> Path:
    """Builds the headless pack from the full data on this machine.

    Args:
        output: also write it into this ``.tar.xz`` file.
        replace: build it again even if it is there.
        progress: receives the progress.

    Returns:
        ``output``, or the root of the pack.

    Raises:
        AssetError: there is no full data, or no room.
    """
    progress = progress or Progress()
    with lock(cache_folder(), progress):
        _ensure_pack(None, replace, progress)
        if output is None:
            return own_folder("headless")
        write_archive(own_folder("headless"), output, progress)
        return output


def clean(*, progress: Progress | None = None) -> list[Path]:
    """Removes what stkzoo put into its cache, and nothing else.

    Returns:
        The removed folders.

    Raises:
        AssetError: the cache cannot be written.
    """
    cache = cache_folder()
    if not cache.is_dir():
        return []
    with lock(cache, progress or Progress()):
        folders = map(own_folder, ("full", "headless", "system"))
        ours = [folder for folder in folders if (folder / MARKER).is_file()]
        for folder in ours:
            discard(folder)
    return ours


def _full_assets(source: str, replace: bool, progress: Progress) -> Assets:
    if not replace:
        with contextlib.suppress(AssetError):
            found = find_assets(graphics=True)
            progress.note(f"the full data is there: {found.root} ({found.source})")
            return found
    problems = []
    for name, fetch in (("debian", _from_debian), ("upstream", _from_upstream)):
        if source in ("auto", name):
            try:
                return fetch(progress)
            except AssetError as error:
                problems.append(f"{name}: {error}")
    raise AssetError(
        "the game's data could not be downloaded.\n"
        + "\n".join(problems)
        + "\nWithout a network, copy a pack from another machine: there "
        "`stkzoo assets pack --output pack.tar.xz`, here `stkzoo assets install --from "
        "pack.tar.xz`."
    )


def _from_debian(progress: Progress) -> Assets:
    with fresh_folder(cache_folder()) as work:
        _make(own_folder("full"), lambda tree: fetch_debian(tree, work, progress))
    return load_assets(own_folder("full"), "stkzoo cache")


def _from_upstream(progress: Progress) -> Assets:
    with fresh_folder(cache_folder()) as work:
        return load_assets(fetch_upstream(work, progress), "pystk2 cache")


def _make(folder: Path, fill: Callable[[Path], object]) -> None:
    """Makes one of our folders, which appears when it is complete."""
    with fresh_folder(cache_folder()) as tree:
        fill(tree)
        publish(tree, folder)


def _ensure_pack(full: Assets | None, replace: bool, progress: Progress) -> None:
    """Builds the headless pack from the full data, which is looked for if it is not given.

    A pack whose scenes are of another version is usable, and stays if there is no full data.
    """
    there = None if replace else _pack_there()
    if there is None or there.scenes != SCENES_VERSION:
        with contextlib.suppress(AssetError):
            full = full or find_assets(graphics=True)
        if there is None or full is not None:
            root = (full or find_assets(graphics=True)).root
            _make(own_folder("headless"), lambda tree: build_headless(root, tree, progress))
            return
    progress.note(f"the headless pack is there: {own_folder('headless')}")


def _pack_there() -> Assets | None:
    """The headless pack in the cache, if it is usable."""
    with contextlib.suppress(AssetError):
        return load_assets(own_folder("headless"), "headless pack")
    return None
