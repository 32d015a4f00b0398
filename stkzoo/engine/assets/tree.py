"""The game's data in a folder: its contents and the checks of what the engine needs."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import asdict, dataclass
from pathlib import Path

from stkzoo._reading import Unreadable, load_json, read_file
from stkzoo.errors import AssetError

#: Version of the game's data. The engine requires an empty file ``data/supertuxkart.VERSION``.
ENGINE_DATA_VERSION = "1.5"

#: File beside ``data`` in every tree that stkzoo makes. It is written last.
MARKER = "stkzoo-assets.json"

_YES = {"y", "yes", "true", "1"}
_NOT_A_RACE = ("arena", "cutscene", "internal", "soccer")


@dataclass(frozen=True)
class Assets:
    """A usable set of the game's data.

    Attributes:
        root: the folder that contains ``data``, a value for ``SUPERTUXKART_DATADIR``.
        source: where the data was found, such as ``"environment"``.
        headless: whether images, music and sounds are placeholders. With them, the game can run
            races but cannot draw them.
        tracks: names of the race tracks, sorted.
        karts: names of the kart models, sorted.
    """

    root: Path
    source: str
    headless: bool
    tracks: tuple[str, ...]
    karts: tuple[str, ...]


#: Version of the trees that stkzoo makes, and of the rules by which it thins scenes.
_LAYOUT = 1
#: Maximum size of the marker and of an XML file [bytes]. The game's largest XML file has 650 kB.
_MAX_MARKER, _MAX_XML = 1 << 20, 8 << 20


def write_marker(root: Path, origin: str, *, headless: bool) -> None:
    """Writes the marker of a finished tree, with the names of its tracks and karts.

    Args:
        root: the tree.
        origin: the source of the tree, such as the name of a package.
        headless: as in :class:`Assets`.

    Raises:
        AssetError: the tree is not usable.
    """
    marker = _Marker(_LAYOUT, origin, headless, *read_catalog(root))
    text = json.dumps(asdict(marker), indent=1, sort_keys=True)
    (root / MARKER).write_text(text + "\n", encoding="utf-8")
    check_shape(root)


def read_marker(root: Path) -> _Marker | None:
    """Reads the marker of a tree.

    Args:
        root: the tree.

    Returns:
        The marker; ``None`` if stkzoo did not make the tree.

    Raises:
        AssetError: the marker cannot be read or is from another version of stkzoo.
    """
    try:
        marker = load_json(root / MARKER, _Marker, _MAX_MARKER)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, Unreadable) as error:
        raise AssetError(f"{root / MARKER} is damaged or cannot be read ({error}).") from error
    if marker.layout != _LAYOUT:
        raise AssetError(
            f"{root} was made by another version of stkzoo (layout {marker.layout}, "
            f"this one makes {_LAYOUT})."
        )
    return marker


@dataclass(frozen=True, slots=True)
class _Marker:
    """The contents of the marker; see :class:`Assets`."""

    layout: int
    origin: str
    headless: bool
    tracks: tuple[str, ...]
    karts: tuple[str, ...]


def check_shape(root: Path) -> _Marker | None:
    """Checks that the files and folders exist without which the engine exits.

    This takes one or two milliseconds, because it does not read the files of the game.

    Args:
        root: the folder that contains ``data``.

    Returns:
        The result of :func:`read_marker`.

    Raises:
        AssetError: a file or folder is missing; the message names the first one.
    """
    data = root / "data"
    if not data.is_dir():
        hint = " (this is a data folder: use its parent folder)"
        above = (root / "stk_config.xml").is_file()
        raise AssetError(f"{root} has no folder 'data'{hint if above else ''}.")
    for name in ("stk_config.xml", f"supertuxkart.{ENGINE_DATA_VERSION}"):
        if not (data / name).is_file():
            raise AssetError(f"{data} has no file {name!r}, which the game needs.")
    for name in ("karts", "skins/classic", "tracks", "ttf"):
        if not (data / name).is_dir():
            raise AssetError(f"{data} has no folder {name!r}, which the game needs.")
    for font in (data / "ttf").iterdir():
        if not font.exists():
            raise AssetError(f"the font {font} is a link to a file that is not there.")
    marker = read_marker(root)
    files = [f"tracks/{name}/track.xml" for name in marker.tracks] if marker else []
    files += [f"karts/{name}/kart.xml" for name in marker.karts] if marker else []
    for name in files:
        if not (data / name).is_file():
            raise AssetError(f"{name!r} is missing from {root}.")
    return marker


def read_catalog(root: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Returns the names of the race tracks and of the kart models, each sorted.

    As in the engine, a track is a race track if its ``track.xml`` does not mark it as an arena, a
    soccer field, a cutscene or internal.

    Args:
        root: the folder that contains ``data``.

    Raises:
        AssetError: a ``track.xml`` cannot be read, or there are no race tracks or no karts.
    """
    data = root / "data"
    tracks = tuple(sorted(p.parent.name for p in data.glob("tracks/*/track.xml") if _is_race(p)))
    karts = tuple(sorted(p.parent.name for p in data.glob("karts/*/kart.xml")))
    if not tracks or not karts:
        raise AssetError(f"{data} holds {len(tracks)} race tracks and {len(karts)} karts.")
    return tracks, karts


def _is_race(description: Path) -> bool:
    track = parse_xml(description)
    return not any(is_true(track, name) for name in _NOT_A_RACE)


def is_true(element: ET.Element, name: str) -> bool:
    """Returns whether an attribute has one of the values that the game takes for true."""
    return element.get(name, "").lower() in _YES


def parse_xml(path: Path) -> ET.Element:
    """Returns the root element of one of the game's XML files.

    Args:
        path: the file.

    Raises:
        AssetError: the file is missing or broken.
    """
    try:
        return ET.fromstring(read_file(path, _MAX_XML))  # noqa: S314 - of bounded size
    except (ET.ParseError, OSError, LookupError, ValueError) as error:
        raise AssetError(f"{path} cannot be read: {error}.") from error


def load_assets(root: Path, source: str) -> Assets:
    """Returns the assets in a folder, checked by :func:`check_shape`.

    Args:
        root: the folder that contains ``data``.
        source: value for :attr:`Assets.source`.

    Raises:
        AssetError: the engine cannot use them.
    """
    marker = check_shape(root)
    if marker is None:
        return Assets(root, source, False, *read_catalog(root))
    return Assets(root, source, marker.headless, marker.tracks, marker.karts)
