"""Adaptation of Debian's data to the engine, in place or as a folder of links.

Debian's data differs from what the engine needs in three points: the empty file that names the
version, the skin ``classic``, and the fonts, which are links to files of other packages. All files
that affect a race are identical.
"""

from __future__ import annotations

import os
from pathlib import Path

from stkzoo.engine.assets.staging import fresh_folder, link_or_copy, publish
from stkzoo.engine.assets.tree import ENGINE_DATA_VERSION, MARKER, read_marker, write_marker
from stkzoo.errors import AssetError

#: Where distributions install the game's data.
SYSTEM_FOLDERS = (
    Path("/usr/share/games/supertuxkart/data"),
    Path("/usr/share/supertuxkart/data"),
)

#: Versions of the data with which races are the same as with the engine's own version.
_KNOWN_VERSIONS = ("1.4", ENGINE_DATA_VERSION)

#: Prefixes of the file names of the dials' images.
_DIAL = ("speed", "gauge_")

_SUBSTITUTE_FONTS = ("wqy-microhei.ttf", "SigmarOne.otf")


def adapt(data: Path) -> None:
    """Changes a data folder so that the engine accepts it.

    Args:
        data: a data folder that belongs to stkzoo.

    Raises:
        AssetError: the data is of another version, or has no skin or no font.
    """
    _check_version(data)
    (data / f"supertuxkart.{ENGINE_DATA_VERSION}").touch()
    _adapt_skin(data / "skins")
    _adapt_fonts(data / "ttf")


def _check_version(data: Path) -> None:
    if not any((data / f"supertuxkart.{version}").exists() for version in _KNOWN_VERSIONS):
        found = sorted(path.name for path in data.glob("supertuxkart.*"))
        raise AssetError(
            f"{data} is from another version of the game ({', '.join(found) or 'not marked'}); "
            f"races need data of {' or '.join(_KNOWN_VERSIONS)}."
        )


def _adapt_skin(skins: Path) -> None:
    classic = skins / "classic"
    if classic.exists():
        return
    others = sorted(path.name for path in skins.iterdir() if (path / "stkskin.xml").exists())
    if not others:
        raise AssetError(f"{skins} has no skin.")
    classic.symlink_to("peach" if "peach" in others else others[0])


def _adapt_fonts(fonts: Path) -> None:
    usable = [fonts / name for name in _SUBSTITUTE_FONTS if (fonts / name).is_file()]
    usable += sorted(path for path in fonts.iterdir() if path.is_file())
    dangling = [path for path in fonts.iterdir() if not path.exists()]
    if dangling and not usable:
        raise AssetError(f"{fonts} has no font.")
    for font in dangling:
        font.unlink()
        link_or_copy(usable[0], font)


def system_overlay(data: Path, target: Path) -> Path:
    """Makes a folder of links to a system installation, which the engine can use.

    The folder is made again only when the installation has changed.

    Args:
        data: data folder of the installation.
        target: folder of the links.

    Returns:
        ``target``, a value for ``SUPERTUXKART_DATADIR``.

    Raises:
        AssetError: the installation cannot be used, or ``target`` is not writable.
    """
    origin = f"{data} of {data.stat().st_mtime_ns}"
    if _is_current(target, origin):
        return target
    _check_version(data)
    try:
        with fresh_folder(target.parent, "overlay") as staging:
            _link(data, staging / "data")
            adapt(staging / "data")
            write_marker(staging, origin, headless=False)
            publish(staging, target)
    except OSError as error:
        if not _is_current(target, origin):
            raise AssetError(f"links to {data} cannot be made in {target}: {error}.") from error
    return target


def link_without_dial(root: Path, target: Path) -> None:
    """Makes links to the game's data, with transparent dials.

    In a window, the game shows dials for the speed and the nitro of the drawn karts. The render
    process moves these karts directly, so the dials would stay near zero.

    Args:
        root: folder of the game's full data, a value for ``SUPERTUXKART_DATADIR``.
        target: an existing folder for the links.
    """
    nothing = root / "data/textures/transparence.png"
    for folder in ("data", "data/gui", "data/gui/icons"):
        (target / folder).unlink(missing_ok=True)
        (target / folder).mkdir()
        for entry in os.scandir(root / folder):
            is_dial = entry.name.startswith(_DIAL)
            (target / folder / entry.name).symlink_to(nothing if is_dial else entry.path)


def _is_current(target: Path, origin: str) -> bool:
    try:
        marker = read_marker(target)
    except AssetError:
        return False
    return marker is not None and marker.source == origin


def _link(data: Path, target: Path) -> None:
    """Makes a link to each entry. ``skins`` and ``ttf`` become folders, because they change."""
    target.mkdir(parents=True)
    for name in ("skins", "ttf"):
        (target / name).mkdir()
    for entry in os.scandir(data):
        if entry.name in ("skins", "ttf"):
            for inner in os.scandir(entry.path):
                (target / entry.name / inner.name).symlink_to(inner.path)
        elif entry.name != MARKER:
            (target / entry.name).symlink_to(entry.path)
