"""The search for the game's data on this machine. This module downloads nothing."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import platformdirs

from stkzoo.engine.assets.tree import ENGINE_DATA_VERSION, Assets, load_assets
from stkzoo.errors import AssetError, reason

_LOGGER = logging.getLogger(__name__)

#: The engine's environment variable for the folder that contains ``data``.
DATADIR_VARIABLE = "SUPERTUXKART_DATADIR"

#: Environment variable for the folder of stkzoo's cache.
CACHE_VARIABLE = "STKZOO_CACHE"


def cache_folder() -> Path:
    """Returns the folder of stkzoo's cache, which may not exist yet."""
    folder = os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_dir("stkzoo")
    return Path(folder).expanduser().absolute()


def own_folder(name: str) -> Path:
    """Returns the folder in stkzoo's cache for one kind of data.

    Args:
        name: ``"full"``, or ``"headless"`` for the headless pack.
    """
    return cache_folder() / name


def pystk2_cache_folder() -> Path:
    """Returns the folder of ``pystk2``'s own downloads, which may not exist."""
    return Path(platformdirs.user_cache_dir("PySuperTuxKart2", "bpiwowar")).expanduser()


@dataclass(frozen=True)
class PlaceReport:
    """The result of a search in one place.

    Attributes:
        source: short name of the place.
        path: the folder that was searched.
        assets: the data in the folder; ``None`` if there is no usable data.
        problem: why the data cannot be used; empty if there is no data or no problem.
    """

    source: str
    path: Path
    assets: Assets | None
    problem: str = ""

    def measure(self) -> int:
        """Returns the size of the files in the folder [bytes]. This walks the whole folder."""
        return sum(file.stat().st_size for file in self.path.rglob("*") if file.is_file())


def survey() -> Iterator[PlaceReport]:
    """Searches every place lazily, in the order of :func:`find_assets`.

    Yields:
        The result for each place. The place named by ``SUPERTUXKART_DATADIR`` is left out if the
        variable is not set.
    """
    if value := os.environ.get(DATADIR_VARIABLE):
        yield _look("environment", Path(value).absolute())
    yield _look("headless pack", own_folder("headless"))
    yield _look("stkzoo cache", own_folder("full"))
    yield _look("pystk2 cache", pystk2_cache_folder() / ENGINE_DATA_VERSION)


def _look(source: str, path: Path) -> PlaceReport:
    try:
        if source == "pystk2 cache" and path.is_dir():
            _check_download(path)
        is_named = source == "environment"
        assets = load_assets(path, source) if is_named or path.is_dir() else None
    except AssetError as error:
        return PlaceReport(source, path, None, str(error))
    except OSError as error:  # such as a home folder that this user cannot search
        return PlaceReport(source, path, None, f"{path} cannot be read ({reason(error)}).")
    return PlaceReport(source, path, assets)


def _check_download(root: Path) -> None:
    if not (root / "__downloaded__.txt").is_file():
        raise AssetError(f"the download of pystk2 in {root} is incomplete.")


def find_assets(*, graphics: bool = False) -> Assets:
    """Finds the game's data on this machine, in a few milliseconds.

    The places are searched in this order: the folder in ``SUPERTUXKART_DATADIR``, the headless
    pack in stkzoo's cache, the full data in stkzoo's cache, and the cache of ``pystk2``.

    Args:
        graphics: whether the game must draw. A headless pack cannot.

    Raises:
        AssetError: there is no data, or the data in ``SUPERTUXKART_DATADIR`` cannot be used. The
            message names the command that fixes it.
    """
    what = "the game's full data, which drawing needs," if graphics else "the game's data"
    problems = [f"{what} is not on this machine. Run `stkzoo assets install`."]
    for place in survey():
        problem = place.problem
        if graphics and place.assets is not None and place.assets.headless:
            problem = "it is a headless pack, which has no pictures to draw with."
        elif place.assets is not None:
            return place.assets
        if place.source == "environment":
            raise AssetError(
                f"the environment variable {DATADIR_VARIABLE} is {str(place.path)!r}, but "
                f"{problem} Unset it and run `stkzoo assets install`, or point it to a folder "
                "that holds the game's 'data'."
            )
        if place.problem:
            _LOGGER.warning("skipping the %s: %s", place.source, place.problem)
            problems.append(f"In the {place.source}: {place.problem}")
    raise AssetError("\n".join(problems))
