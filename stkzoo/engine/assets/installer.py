"""Installing the game's data, building the headless pack, and removing both."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from stkzoo.engine.assets.fetch import fetch_debian, fetch_upstream
from stkzoo.engine.assets.find import (
    DATADIR_VARIABLE,
    cache_folder,
    find_assets,
    find_assets_or_none,
    full_folder,
    headless_folder,
    named_place,
    overlay_folder,
)
from stkzoo.engine.assets.headless import build_headless, read_archive, write_archive
from stkzoo.engine.assets.staging import (
    Progress,
    clear_leftovers,
    discard,
    lock,
    publish,
    staging_folder,
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
        clear_leftovers(cache_folder())
        if archive is not None:
            _take_archive(archive, progress)
        elif named_place() is not None and not replace:
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
        clear_leftovers(cache_folder())
        if replace or _usable_pack() is None:
            _ensure_pack(find_assets(graphics=True), replace, progress)
        if output is None:
            return headless_folder()
        write_archive(headless_folder(), output, progress)
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
        clear_leftovers(cache)
        folders = [full_folder(), headless_folder(), overlay_folder()]
        ours = [folder for folder in folders if (folder / MARKER).is_file()]
        for folder in ours:
            discard(folder)
    return ours


def _full_assets(source: str, replace: bool, progress: Progress) -> Assets:
    found = None if replace else find_assets_or_none(graphics=True)
    if found is not None:
        progress.note(f"the full data is there: {found.root} ({found.source})")
        return found
    attempts: dict[str, Callable[[Progress], Assets]] = {
        "debian": _from_debian,
        "upstream": _from_upstream,
    }
    wanted = list(attempts) if source == "auto" else [source]
    problems: list[str] = []
    for name in wanted:
        try:
            return attempts[name](progress)
        except AssetError as error:  # noqa: PERF203 - two rounds at most
            problems.append(f"{name}: {error}")
    raise AssetError(
        "the game's data could not be downloaded.\n"
        + "\n".join(problems)
        + "\nWithout a network, copy a pack from another machine: there "
        "`stkzoo assets pack --output pack.tar.xz`, here `stkzoo assets install --from "
        "pack.tar.xz`."
    )


def _from_debian(progress: Progress) -> Assets:
    with staging_folder(cache_folder()) as tree, staging_folder(cache_folder()) as work:
        fetch_debian(tree, work, progress)
        publish(tree, full_folder())
    return load_assets(full_folder(), "stkzoo cache")


def _from_upstream(progress: Progress) -> Assets:
    with staging_folder(cache_folder()) as work:
        return load_assets(fetch_upstream(work, progress), "pystk2 cache")


def _usable_pack() -> Assets | None:
    try:
        return load_assets(headless_folder(), "headless pack")
    except AssetError:
        return None


def _ensure_pack(full: Assets, replace: bool, progress: Progress) -> None:
    if not replace and _usable_pack() is not None:
        progress.note(f"the headless pack is there: {headless_folder()}")
        return
    if full.headless:
        raise AssetError(f"{full.root} is a headless pack; packing needs the full data.")
    with staging_folder(cache_folder()) as tree:
        build_headless(full.root, tree, progress)
        publish(tree, headless_folder())


def _take_archive(archive: Path, progress: Progress) -> None:
    if not archive.is_file():
        raise AssetError(f"there is no file {os.fspath(archive)!r}.")
    with staging_folder(cache_folder()) as tree:
        read_archive(archive, tree, progress)
        publish(tree, headless_folder())
