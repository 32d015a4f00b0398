"""The places where the game's data may lie, in the order in which they are asked."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import platformdirs

from stkzoo.engine.assets.overlay import SYSTEM_FOLDERS, system_overlay
from stkzoo.engine.assets.tree import ENGINE_DATA_VERSION, Assets, load_assets
from stkzoo.errors import AssetError

__all__ = [
    "CACHE_VARIABLE",
    "DATADIR_VARIABLE",
    "Place",
    "cache_folder",
    "environment_place",
    "full_folder",
    "headless_folder",
    "overlay_folder",
    "places",
    "pystk2_cache_folder",
]

#: The engine's own variable: the folder that holds ``data``.
DATADIR_VARIABLE = "SUPERTUXKART_DATADIR"

#: Moves stkzoo's cache elsewhere.
CACHE_VARIABLE = "STKZOO_CACHE"


def cache_folder() -> Path:
    """The folder that stkzoo owns; it may not exist yet."""
    own = os.environ.get(CACHE_VARIABLE)
    folder = Path(own).expanduser() if own else Path(platformdirs.user_cache_dir("stkzoo"))
    return folder.absolute()


def full_folder() -> Path:
    """Where a full set of data goes."""
    return cache_folder() / "full"


def headless_folder() -> Path:
    """Where the headless pack goes."""
    return cache_folder() / "headless"


def overlay_folder() -> Path:
    """Where the links into a system install go."""
    return cache_folder() / "system"


def pystk2_cache_folder() -> Path:
    """Where ``pystk2`` keeps what it downloads by itself; may not exist."""
    return Path(platformdirs.user_cache_dir("PySuperTuxKart2", "bpiwowar"))


@dataclass(frozen=True)
class Place:
    """One place to look at.

    Attributes:
        source: its short name, as in :attr:`Assets.source`.
        path: the folder in question.
        look: gives the assets, ``None`` if nothing is there, or raises
            :class:`~stkzoo.errors.AssetError` if what is there is of no use.
    """

    source: str
    path: Path
    look: Callable[[], Assets | None]


def environment_place() -> Place | None:
    """The folder that the user's environment names, ``None`` if it names none."""
    value = os.environ.get(DATADIR_VARIABLE)
    if not value:
        return None
    path = Path(value)
    return Place("environment", path, partial(_look_named, path))


def _look_named(path: Path) -> Assets:
    try:
        return load_assets(path.absolute(), "environment")
    except AssetError as error:
        raise AssetError(
            f"the environment variable {DATADIR_VARIABLE} is {str(path)!r}, but {error} "
            f"Unset it and run `stkzoo assets install`, or point it to a folder that "
            f"holds the game's 'data'."
        ) from error


def places() -> Iterator[Place]:
    """All places in order: the one the environment names, then the machine's own."""
    named = environment_place()
    if named is not None:
        yield named
    headless, full = headless_folder(), full_folder()
    yield Place("headless pack", headless, partial(_look_made, headless, "headless pack"))
    yield Place("stkzoo cache", full, partial(_look_made, full, "stkzoo cache"))
    downloaded = pystk2_cache_folder() / ENGINE_DATA_VERSION
    yield Place("pystk2 cache", downloaded, partial(_look_downloaded, downloaded))
    for folder in SYSTEM_FOLDERS:
        yield Place("system", folder, partial(_look_system, folder))


def _look_made(root: Path, source: str) -> Assets | None:
    return load_assets(root, source) if root.is_dir() else None


def _look_downloaded(root: Path) -> Assets | None:
    if not root.is_dir():
        return None
    if not (root / "__downloaded__.txt").is_file():
        raise AssetError(f"the download of pystk2 in {root} was never finished.")
    return load_assets(root, "pystk2 cache")


def _look_system(data: Path) -> Assets | None:
    if not data.is_dir():
        return None
    return load_assets(system_overlay(data, overlay_folder()), "system")
