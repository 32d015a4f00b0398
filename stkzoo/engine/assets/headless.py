"""The headless pack: the game's data without pictures and sounds, as a folder or one file.

A tiny file of the same name replaces every picture, piece of music and sound. None may be
missing: the game derives the properties of the ground from its materials, and a material
without its picture or sound changes how karts drive on it. Scenes lose what is only seen or heard
(:mod:`stkzoo.engine.assets.scenes`). Races are bit for bit those of the full data. The pack as one
archive is for clusters and containers.
"""

from __future__ import annotations

import base64
import lzma
import os
import shutil
import tarfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, BinaryIO, cast

from stkzoo._os import write_whole
from stkzoo.engine.assets.scenes import thin_scenes
from stkzoo.engine.assets.staging import Progress, link_or_copy
from stkzoo.engine.assets.tree import MARKER, load_assets, write_marker
from stkzoo.errors import AssetError

#: Files that a placeholder replaces.
_KINDS = dict.fromkeys((".flac", ".mp3", ".oga", ".ogg", ".wav"), "sound")
_KINDS |= {".jpeg": "jpeg", ".jpg": "jpeg", ".png": "png"}

#: A gray picture of 4x4 pixels, as a PNG and as a baseline JPEG file.
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
        AssetError: a scene of the source cannot be read.
        OSError: the pack cannot be written.
    """
    files = list(_files(source / "data"))
    kept = sum(path.stat().st_size for path in files if _kind(path) == "keep")
    progress.begin("building the headless pack", kept)
    placeholders = _placeholders(target, files)
    done = 0
    for path in files:
        goal = target / "data" / path.relative_to(source / "data")
        media = _kind(path)
        goal.parent.mkdir(parents=True, exist_ok=True)
        link_or_copy(placeholders.get(media, path), goal)
        if media == "keep":
            done += path.stat().st_size
            progress.reach(done)
    for file in placeholders.values():
        file.unlink()
    thin_scenes(target / "data")
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
    placeholders = {media: root / f".{media}" for media in contents}
    for media, content in contents.items():
        placeholders[media].write_bytes(content)
    return placeholders


def _files(data: Path) -> Iterator[Path]:
    for folder, _, names in os.walk(data, followlinks=True):
        yield from filter(Path.is_file, (Path(folder, name) for name in names))


def _kind(path: Path) -> str:
    return _KINDS.get(path.suffix.lower(), "keep")


#: Limits of an archive; the pack of the whole game has 5,300 files of 144 MB: the unpacked size,
#: the number of files, and the size of a description [bytes]. A byte of XML takes up to 40 of
#: memory.
_LARGEST, _MAX_MEMBERS, _MAX_XML = 2_000_000_000, 20_000, 1 << 20
#: Limit of an unpacked archive: a factor of its size, and a size that is always allowed [bytes].
_MAX_RATIO, _SMALL = 30, 4 << 20
#: Maximum size of a read from an archive [bytes]. Only headers that no pack has need more.
_MAX_READ = 1 << 20


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
        progress.begin(f"unpacking {file.name}", size)
        with file.open("rb") as raw, _UnpackedFile(raw, _SMALL + _MAX_RATIO * size) as stream:
            with tarfile.open(fileobj=stream, mode="r:") as archive:
                _write_members(archive, target, lambda: progress.reach(raw.tell()))
            while stream.read(_MAX_READ):  # the checksum is at the end
                pass
        is_pack = load_assets(target, "archive").headless
    except (tarfile.TarError, lzma.LZMAError, EOFError, ValueError, RecursionError) as error:
        raise AssetError(
            f"{file} is damaged, or not written by `stkzoo assets pack --output`: {error}. "
            f"Copy it again, or make a new one."
        ) from error
    except OSError as error:
        raise AssetError(f"{file} cannot be unpacked: {error}.") from error
    if not is_pack:
        raise AssetError(f"{file} does not contain a headless pack.")


class _UnpackedFile(lzma.LZMAFile):
    """The tar file in an archive, of bounded size, which is read in pieces of bounded size."""

    def __init__(self, raw: BinaryIO, most: int) -> None:
        super().__init__(raw)
        self._most = min(most, _LARGEST)

    def read(self, size: int | None = -1) -> bytes:
        """See :meth:`lzma.LZMAFile.read`.

        Raises:
            ReadError: the size, or the position in the file, is above its limit.
        """
        if size is None or not 0 <= size <= _MAX_READ:
            raise tarfile.ReadError(f"it has a header of {size:,} bytes, expected a small one")
        if self.tell() > self._most:
            raise tarfile.ReadError("it unpacks to more than a headless pack of its size")
        return super().read(size)


def _write_members(archive: tarfile.TarFile, target: Path, report: Callable[[], None]) -> None:
    """Writes all members.

    Args:
        archive: the unpacked archive.
        target: the folder of the pack.
        report: called after each member.
    """
    for number, member in enumerate(archive):
        if number >= _MAX_MEMBERS:
            raise tarfile.ReadError(f"it has more than {_MAX_MEMBERS:,} files")
        goal = _goal_of(member, target.resolve())
        goal.parent.mkdir(parents=True, exist_ok=True)
        with goal.open("xb") as file:
            shutil.copyfileobj(cast("IO[bytes]", archive.extractfile(member)), file)
        report()


def _goal_of(member: tarfile.TarInfo, root: Path) -> Path:
    """Returns where to write a member.

    Raises:
        ReadError: it is outside the pack, a link, a device or a folder, or too large.
    """
    goal, name = (root / member.name).resolve(), repr(member.name[:100])
    if goal != root / MARKER and root / "data" not in goal.parents:
        raise tarfile.ReadError(f"its file {name} would lie outside the pack")
    if not member.isreg() or member.issparse():
        raise tarfile.ReadError(f"its member {name} is not a regular file")
    most = _MAX_XML if goal.suffix in (".xml", ".json") else _LARGEST
    if not 0 <= member.size <= most:
        raise tarfile.ReadError(f"its file {name} has {member.size:,} bytes, expected <= {most:,}")
    return goal
