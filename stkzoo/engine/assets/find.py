"""Finding the game's data: the places to look in, in order. Nothing is downloaded here."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import platformdirs

from stkzoo.engine.assets.overlay import SYSTEM_FOLDERS, system_overlay
from stkzoo.engine.assets.tree import ENGINE_DATA_VERSION, Assets, load_assets
from stkzoo.errors import AssetError

#: The engine's own variable: the folder that holds ``data``.
DATADIR_VARIABLE = "SUPERTUXKART_DATADIR"

#: Environment variable that moves stkzoo's cache.
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
    """Where ``pystk2`` keeps its own downloads; may not exist."""
    return Path(platformdirs.user_cache_dir("PySuperTuxKart2", "bpiwowar"))


@dataclass(frozen=True)
class PlaceReport:
    """What one place holds.

    Attributes:
        source: the place's short name.
        path: the folder that was looked at.
        assets: what is there, ``None`` if nothing usable is.
        problem: why it cannot be used; empty if nothing is there or all is well.
    """

    source: str
    path: Path
    assets: Assets | None
    problem: str = ""

    def measure(self) -> int:
        """Size of the files that are there [bytes]; reads the whole folder."""
        sizes = {}
        for folder, _, names in os.walk(self.path, followlinks=True):
            for entry in (Path(folder, name) for name in names):
                with suppress(FileNotFoundError):
                    status = entry.stat()
                    sizes[status.st_dev, status.st_ino] = status.st_size
        return sum(sizes.values())


def named_place() -> PlaceReport | None:
    """The folder that the user's environment names, ``None`` if it names none."""
    value = os.environ.get(DATADIR_VARIABLE)
    if not value:
        return None
    path = Path(value)
    try:
        return PlaceReport("environment", path, load_assets(path.absolute(), "environment"))
    except AssetError as error:
        problem = (
            f"the environment variable {DATADIR_VARIABLE} is {str(path)!r}, but {error} "
            f"Unset it and run `stkzoo assets install`, or point it to a folder that "
            f"holds the game's 'data'."
        )
        return PlaceReport("environment", path, None, problem)


def _own_places() -> Iterator[PlaceReport]:
    """The machine's own places, in order; each is looked at when it is its turn."""
    yield _look("headless pack", headless_folder())
    yield _look("stkzoo cache", full_folder())
    yield _look("pystk2 cache", pystk2_cache_folder() / ENGINE_DATA_VERSION, _downloaded)
    for folder in SYSTEM_FOLDERS:
        yield _look("system", folder, _overlaid)


def _look(source: str, path: Path, root_of: Callable[[Path], Path] = Path) -> PlaceReport:
    try:
        assets = load_assets(root_of(path), source) if path.is_dir() else None
    except AssetError as error:
        return PlaceReport(source, path, None, str(error))
    return PlaceReport(source, path, assets)


def _downloaded(root: Path) -> Path:
    if not (root / "__downloaded__.txt").is_file():
        raise AssetError(f"the download of pystk2 in {root} was never finished.")
    return root


def _overlaid(data: Path) -> Path:
    return system_overlay(data, overlay_folder())


_LOGGER = logging.getLogger(__name__)

_REMEDY = "Run `stkzoo assets install`."


def find_assets(*, graphics: bool = False) -> Assets:
    """Finds the game's data on this machine, in a few milliseconds.

    The order is: the folder in ``SUPERTUXKART_DATADIR``, the headless pack and
    the full data in stkzoo's cache, the cache of ``pystk2``, a system install.

    Args:
        graphics: the game must draw, which a headless pack cannot.

    Raises:
        AssetError: there is none, or what the environment names cannot be used; the
            message names the command that fixes it.
    """
    found, problems = _first_usable(graphics)
    if found is None:
        raise AssetError(_missing_text(graphics, problems))
    return found


def find_assets_or_none(*, graphics: bool = False) -> Assets | None:
    """Like :func:`find_assets`, but ``None`` where the machine has none.

    Raises:
        AssetError: what the environment names cannot be used.
    """
    return _first_usable(graphics)[0]


def _first_usable(graphics: bool) -> tuple[Assets | None, list[str]]:
    if (named := named_place()) is not None:
        return _named_assets(named, graphics), []
    problems: list[str] = []
    for place in _own_places():
        if place.problem:
            _LOGGER.warning("skipping the %s: %s", place.source, place.problem)
            problems.append(f"In the {place.source}: {place.problem}")
        elif place.assets is not None and not (graphics and place.assets.headless):
            return place.assets, problems
    return None, problems


def _named_assets(place: PlaceReport, graphics: bool) -> Assets:
    if place.assets is None:
        raise AssetError(place.problem)
    if graphics and place.assets.headless:
        raise AssetError(
            f"the environment variable SUPERTUXKART_DATADIR is {str(place.path)!r}, a headless "
            f"pack, which has no pictures to draw with. Unset it and run "
            f"`stkzoo assets install`."
        )
    return place.assets


def _missing_text(graphics: bool, problems: list[str]) -> str:
    what = "the game's full data, which drawing needs," if graphics else "the game's data"
    return "\n".join([f"{what} is not on this machine. {_REMEDY}", *problems])


def survey() -> list[PlaceReport]:
    """Looks at every place, in the order of :func:`find_assets`."""
    named = named_place()
    return [*([named] if named else []), *_own_places()]
