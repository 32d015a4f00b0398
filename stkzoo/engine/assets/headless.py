"""The headless pack: the game's data without pictures and sounds, as a folder or one file.

A tiny file of the same name replaces every picture, piece of music and sound. None may be
missing: the game derives the properties of the ground from its materials, and a material
without its picture or sound changes how karts drive on it. Races are bit for bit those of
the full data. The pack as one archive is for clusters and containers.
"""

from __future__ import annotations

import base64
import hashlib
import lzma
import os
import tarfile
from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath

from stkzoo._os import write_whole
from stkzoo.engine.assets.staging import Progress, check_space, link_or_copy
from stkzoo.engine.assets.tree import MARKER, check_files, read_marker, write_marker
from stkzoo.errors import AssetError

#: Files that a placeholder replaces.
_KINDS = dict.fromkeys((".flac", ".mp3", ".oga", ".ogg", ".wav"), "sound")
_KINDS |= {".jpeg": "jpeg", ".jpg": "jpeg", ".png": "png"}

#: A grey picture of 4x4 pixels, as a PNG and as a baseline JPEG file.
PLACEHOLDER_PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAQAAAAECAIAAAAmkwkpAAAADklEQVR42mNoQAIMxHEAcFIYAZ6uvm8AAAAASUVO"
    "RK5CYII="
)
PLACEHOLDER_JPEG = base64.b64decode(
    "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDAAEBAQEBAQEBAQEBAQEBAQEBAQEBAQEBAQEBAQEBAQEBAQEBAQEBAQEB"
    "AQEBAQEBAQEBAQEBAQEBAQEBAQEBAQH/wAARCAAEAAQDAREAAhEAAxEA/8QAJgABAAAAAAAAAAAAAAAAAAAAABAB"
    "AAAAAAAAAAAAAAAAAAAAAP/aAAwDAQACAAMAAD8AA//Z"
)


def build_headless(source: Path, target: Path, progress: Progress) -> None:
    """Makes the headless pack of a full tree.

    Files are hard links to the source where the file system allows it, so the pack takes
    little room beside stkzoo's own full data.

    Args:
        source: root of the full tree.
        target: an empty folder, which becomes the root of the pack.
        progress: receives the progress.

    Raises:
        AssetError: the source is incomplete, or the disk has no room.
    """
    check_files(source)
    files = list(_files(source / "data"))
    kept = sum(size for path, size in files if _kind(path) == "keep")
    check_space(target, kept + 32_000_000, "the headless pack")
    progress.begin("building the headless pack", kept)
    placeholders = _placeholders(target, [path for path, _ in files])
    done = 0
    for path, size in files:
        goal = target / "data" / path.relative_to(source / "data")
        kind = _kind(path)
        goal.parent.mkdir(parents=True, exist_ok=True)
        link_or_copy(placeholders.get(kind, path), goal)
        if kind == "keep":
            done += size
            progress.reach(done)
    for file in placeholders.values():
        file.unlink()
    write_marker(target, "headless pack", headless=True)


def _placeholders(root: Path, files: list[Path]) -> dict[str, Path]:
    """One small file of each kind, which is linked under every name that needs it.

    The sound is the smallest of the game's own.
    """
    contents = {"png": PLACEHOLDER_PNG, "jpeg": PLACEHOLDER_JPEG}
    sounds = [path for path in files if _kind(path) == "sound"]
    if sounds:
        smallest = min(sounds, key=lambda path: (path.stat().st_size, path.name))
        contents["sound"] = smallest.read_bytes()
    placeholders = {kind: root / f".{kind}" for kind in contents}
    for kind, content in contents.items():
        placeholders[kind].write_bytes(content)
    return placeholders


def _files(data: Path) -> Iterator[tuple[Path, int]]:
    for folder, _, names in os.walk(data, followlinks=True):
        for name in names:
            path = Path(folder, name)
            if path.is_file():
                yield path, path.stat().st_size


def _kind(path: Path) -> str:
    return _KINDS.get(path.suffix.lower(), "keep")


#: An archive that unpacks to more than this is not one of ours [bytes].
_LARGEST = 2_000_000_000


def write_archive(root: Path, file: Path, progress: Progress) -> None:
    """Packs a headless tree into a ``.tar.xz`` file.

    The same tree gives the same bytes: members are sorted and have neither time nor
    owner. The file appears when it is complete.

    Args:
        root: the headless pack.
        file: the archive; an existing one is replaced.
        progress: receives the progress.

    Raises:
        AssetError: the folder of ``file`` cannot be written.
    """
    paths = [root / MARKER, *sorted(path for path in root.glob("data/**/*") if path.is_file())]
    progress.begin("writing the archive", sum(path.stat().st_size for path in paths))
    done = 0
    with (
        write_whole(file, "the archive", AssetError) as part,
        tarfile.open(part, "w:xz", format=tarfile.PAX_FORMAT) as archive,
    ):
        for path in paths:
            member = tarfile.TarInfo(path.relative_to(root).as_posix())
            member.size = path.stat().st_size
            with path.open("rb") as stream:
                archive.addfile(member, stream)
            done += member.size
            progress.reach(done)


def read_archive(file: Path, target: Path, progress: Progress) -> None:
    """Unpacks what :func:`write_archive` made; the checksums of ``.xz`` cover every byte of it.

    Args:
        file: the archive.
        target: an empty folder, which becomes the root of the pack.
        progress: receives the progress.

    Raises:
        AssetError: the file is missing, broken, or no archive of ours.
    """
    try:
        size = file.stat().st_size
        check_space(target, 4 * size, "the headless pack")
        progress.begin(f"unpacking {file.name}", size)
        with file.open("rb") as raw, lzma.open(raw) as stream:
            with tarfile.open(fileobj=stream, mode="r|") as archive:
                _unpack(archive, target, lambda: progress.reach(raw.tell()))
            while stream.read(1 << 20):  # the checksum is at the end
                pass
        check_files(target)
        marker = read_marker(target)
    except (tarfile.TarError, lzma.LZMAError, EOFError, UnicodeError) as error:
        raise AssetError(
            f"{file} is broken or no archive of `stkzoo assets pack --output`: {error}. "
            f"Copy it again, or make a new one."
        ) from error
    except OSError as error:
        raise AssetError(f"{file} cannot be unpacked: {error}.") from error
    if marker is None or not marker.headless:
        raise AssetError(f"{file} holds no headless pack.")


def _unpack(archive: tarfile.TarFile, target: Path, report: Callable[[], None]) -> None:
    """Writes all members; equal ones become links to one file."""
    total = 0
    first: dict[bytes, Path] = {}
    for member in archive:
        total += member.size
        _check_member(member, target, total)
        stream = archive.extractfile(member)
        content = stream.read() if stream else b""
        goal = target / member.name
        goal.parent.mkdir(parents=True, exist_ok=True)
        same = first.setdefault(hashlib.sha256(content).digest(), goal)
        if same == goal:
            goal.write_bytes(content)
        else:
            link_or_copy(same, goal)
        report()


def _check_member(member: tarfile.TarInfo, target: Path, total: int) -> None:
    name, path = member.name, PurePosixPath(member.name)
    outside = path.is_absolute() or ".." in path.parts or any(sign in name for sign in "\\:\0")
    if outside or not path.parts or path.parts[0] not in ("data", MARKER):
        raise AssetError(
            f"the archive's member {name!r} would lie outside the pack. Make a new archive with "
            "`stkzoo assets pack --output`."
        )
    if not member.isreg() or (target / name).exists():
        raise AssetError(f"the archive's member {name!r} is no plain file, or comes twice.")
    if total > _LARGEST:
        raise AssetError(f"the archive unpacks to more than {_LARGEST / 1e9:.0f} GB.")
