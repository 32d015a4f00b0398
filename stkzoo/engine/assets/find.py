"""Finding the game's data; never fetching it."""

from __future__ import annotations

import logging
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from stkzoo.engine.assets.places import Place, environment_place, places
from stkzoo.engine.assets.tree import Assets
from stkzoo.errors import AssetError

__all__ = ["PlaceReport", "find_assets", "find_assets_or_none", "survey"]

_LOGGER = logging.getLogger(__name__)

_REMEDY = "Run `stkzoo assets install`."


def find_assets(*, graphics: bool = False) -> Assets:
    """The game's data on this machine; takes a few milliseconds, downloads nothing.

    Asked in this order: the folder in ``SUPERTUXKART_DATADIR``, the headless pack and
    the full data in stkzoo's cache, the cache of ``pystk2``, a system install.

    Args:
        graphics: the game shall draw; a headless pack will not do.

    Raises:
        AssetError: there is none, or what the environment names is of no use; the
            message names the command that mends it.
    """
    named = environment_place()
    if named is not None:
        return _take_named(named, graphics)
    found, problems = _first_usable(graphics)
    if found is not None:
        return found
    raise AssetError(_missing_text(graphics, problems))


def find_assets_or_none(*, graphics: bool = False) -> Assets | None:
    """Like :func:`find_assets`, but ``None`` where the machine has none.

    Raises:
        AssetError: what the environment names is of no use.
    """
    named = environment_place()
    return _take_named(named, graphics) if named is not None else _first_usable(graphics)[0]


def _take_named(place: Place, graphics: bool) -> Assets:
    assets = place.look()
    if assets is None or (graphics and assets.headless):
        raise AssetError(
            f"the environment variable SUPERTUXKART_DATADIR is {str(place.path)!r}, a headless "
            f"pack, which has no pictures to draw with. Unset it and run "
            f"`stkzoo assets install`."
        )
    return assets


def _first_usable(graphics: bool) -> tuple[Assets | None, list[str]]:
    problems: list[str] = []
    for place in places():
        try:
            assets = place.look()
        except AssetError as error:
            _LOGGER.warning("passing over the %s: %s", place.source, error)
            problems.append(f"In the {place.source}: {error}")
            continue
        if assets is not None and not (graphics and assets.headless):
            return assets, problems
    return None, problems


def _missing_text(graphics: bool, problems: list[str]) -> str:
    what = "the game's full data, which drawing needs," if graphics else "the game's data"
    return "\n".join([f"{what} is not on this machine. {_REMEDY}", *problems])


@dataclass(frozen=True)
class PlaceReport:
    """What one place holds.

    Attributes:
        source: the place's short name.
        path: the folder that was looked at.
        assets: what is there, ``None`` if nothing usable is.
        problem: why it is of no use; empty if nothing is there or all is well.
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


def survey() -> list[PlaceReport]:
    """Looks at every place, in the order in which :func:`find_assets` asks them."""
    return [_report(place) for place in places()]


def _report(place: Place) -> PlaceReport:
    try:
        return PlaceReport(place.source, place.path, place.look())
    except AssetError as error:
        return PlaceReport(place.source, place.path, None, str(error))
