"""The headless pack: the game's data without pictures and sounds, as a folder or one file.

A tiny file of the same name replaces every picture, piece of music and sound. None may be
missing: the game derives the properties of the ground from its materials, and a material
without its picture or sound changes how karts drive on it. Scenes lose what is only seen or heard
(:mod:`stkzoo.engine.assets.scenes`). Races are bit for bit those of the full data. The pack as one
archive is for clusters and containers.
"""

from __future__ import annotations

import base64
import hashlib
import lzma
import os
import tarfile
from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from stkzoo._os import write_whole
from stkzoo.engine.assets.scenes import SCENES_VERSION, thin_scenes
from stkzoo.engine.assets.staging import Progress, check_space, link_or_copy
from stkzoo.engine.assets.tree import MARKER, check_files, read_marker, write_marker
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


def build_headless(
    source: Path, target: Path, progress: Progress, *, has_whole_scenes: bool = False
) -> None:
    """Makes the headless pack of a full tree.

    Files are hard links to the source where the file system allows it, so the pack takes
    little room beside stkzoo's own full data.

    Args:
        source: root of the full tree.
        target: an empty folder, which becomes the root of the pack.
        progress: receives the progress.
        has_whole_scenes: leave the scenes as they are, which makes steps of a race slower.

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
    if not has_whole_scenes:
        thin_scenes(target / "data")
    scenes = 0 if has_whole_scenes else SCENES_VERSION
    write_marker(target, "headless pack", headless=True, scenes=scenes)


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


#: Limits of an archive; the pack of the whole game has 5,300 files of 144 MB: its largest size,
#: number of files, size of one, and how much it grows when it is unpacked [bytes].
_LARGEST, _MAX_MEMBERS, _MAX_SIZE = 2_000_000_000, 20_000, 64 << 20
#: The size of a description [bytes]: a byte of XML takes up to 40 of memory.
_MAX_XML = 1 << 20
_MAX_RATIO, _SMALL = 30, 4 << 20
#: Long names are in headers of this size; paths have so many parts.
_MAX_HEADER, _MAX_DEPTH = 1024, 16
#: Memory of the decompressor, and of what is read at a time [bytes]. ``write_archive`` needs 9 MB.
_XZ_MEMORY, _BLOCK, _PACKED_BLOCK = 36 << 20, 1 << 20, 1 << 16


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
        _unpack(file, target, _SMALL + _MAX_RATIO * size, progress)
        check_files(target)
        marker = read_marker(target)
    except (tarfile.TarError, lzma.LZMAError, EOFError, ValueError) as error:
        raise AssetError(
            f"{file} is damaged, or not written by `stkzoo assets pack --output`: {error}. "
            f"Copy it again, or make a new one."
        ) from error
    except OSError as error:
        raise AssetError(f"{file} cannot be unpacked: {error}.") from error
    if marker is None or not marker.headless:
        raise AssetError(f"{file} does not contain a headless pack.")


class _XzReader:
    """Unpacks a file of ``.xz`` in bounded memory, whatever the file asks for."""

    def __init__(self, raw: BinaryIO) -> None:
        self._raw = raw
        self._unpacker = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_XZ_MEMORY)

    def read(self, count: int) -> bytes:
        """Exactly ``count`` bytes.

        Raises:
            EOFError: there are fewer.
        """
        blocks = []
        while count:
            block = self._next(count)
            if not block and self._unpacker.eof:
                raise EOFError("it is cut off")
            blocks.append(block)
            count -= len(block)
        return b"".join(blocks)

    def check_end(self) -> None:
        """Reads to the end, where the checksum is.

        Raises:
            EOFError: the end is missing.
        """
        while not self._unpacker.eof:
            self._next(_BLOCK)

    def _next(self, count: int) -> bytes:
        """Up to ``count`` bytes; may be empty before the end."""
        data = self._raw.read(_PACKED_BLOCK) if self._unpacker.needs_input else b""
        if not data and self._unpacker.needs_input:
            raise EOFError("it is cut off")
        return self._unpacker.decompress(data, count)


def _unpack(archive: Path, target: Path, most: int, progress: Progress) -> None:
    """Writes all members, at most ``most`` bytes; the checksum is at the archive's end."""
    with archive.open("rb") as raw:
        stream = _XzReader(raw)
        _write_members(stream, target, most, lambda: progress.reach(raw.tell()))
        stream.check_end()


def _write_members(stream: _XzReader, target: Path, most: int, report: Callable[[], None]) -> None:
    """Writes all members; equal ones become links to one file.

    Args:
        stream: the unpacked archive.
        target: the folder of the pack.
        most: the largest size of all members together [bytes].
        report: called after each member.
    """
    left = min(most, _LARGEST)
    first: dict[bytes, Path] = {}
    for number, member in enumerate(_members(stream)):
        if number >= _MAX_MEMBERS:
            raise AssetError(f"the archive has more than {_MAX_MEMBERS:,} members.")
        left -= member.size
        _check_member(member, target, left)
        goal = target / member.name
        goal.parent.mkdir(parents=True, exist_ok=True)
        digest = _write_member(stream, goal, member.size)
        same = first.setdefault(digest, goal)
        if same != goal:
            goal.unlink()
            link_or_copy(same, goal)
        report()


def _members(stream: _XzReader) -> Iterator[tarfile.TarInfo]:
    """The members' headers. The content of each is read before the next header.

    Of all forms of tar only plain files and long names are known, which :func:`write_archive`
    makes: the others take memory that no header declares.
    """
    name = ""
    while any(block := stream.read(tarfile.BLOCKSIZE)):
        member = tarfile.TarInfo.frombuf(block, "utf-8", "strict")
        if member.type == tarfile.XHDTYPE:
            if not 0 < member.size <= _MAX_HEADER:
                raise AssetError(
                    f"the archive has a header of {member.size:,} bytes, expected at most "
                    f"{_MAX_HEADER:,}. Make a new archive with `stkzoo assets pack --output`."
                )
            name = _long_name(stream.read(member.size + _padding(member.size))[: member.size])
            continue
        member.name, name = name or member.name, ""
        yield member
        stream.read(_padding(member.size))


def _padding(size: int) -> int:
    return -size % tarfile.BLOCKSIZE


def _long_name(header: bytes) -> str:
    """The path in a pax header: lines of ``LENGTH NAME=VALUE``.

    Raises:
        AssetError: it has something else.
    """
    length, _, entry = header.partition(b" ")
    if length != str(len(header)).encode() or not entry.startswith(b"path="):
        raise AssetError(f"the archive has the header {header[:60]!r}, expected a long name only.")
    return entry.removeprefix(b"path=").removesuffix(b"\n").decode()


def _write_member(stream: _XzReader, goal: Path, size: int) -> bytes:
    """Writes the content of a member; returns its digest."""
    digest = hashlib.sha256()
    with goal.open("xb") as file:
        for start in range(0, size, _BLOCK):
            block = stream.read(min(_BLOCK, size - start))
            digest.update(block)
            file.write(block)
    return digest.digest()


def _check_member(member: tarfile.TarInfo, target: Path, left: int) -> None:
    name, path = member.name, PurePosixPath(member.name)
    outside = path.is_absolute() or ".." in path.parts or any(sign in name for sign in "\\:\0")
    if outside or not path.parts or path.parts[0] not in ("data", MARKER):
        raise AssetError(
            f"the archive's member {name[:100]!r} would lie outside the pack. Make a new archive "
            "with `stkzoo assets pack --output`."
        )
    if not member.isreg() or len(path.parts) > _MAX_DEPTH or (target / name).exists():
        raise AssetError(
            f"the archive's member {name[:100]!r} is not a regular file, is nested too "
            "deep, or occurs twice."
        )
    most = _MAX_XML if path.suffix in (".xml", ".json") else _MAX_SIZE
    if not 0 <= member.size <= most:
        raise AssetError(
            f"the archive's member {name[:100]!r} has {member.size:,} bytes, expected at most "
            f"{most:,}."
        )
    if left < 0:
        raise AssetError(
            "the archive unpacks to more than a headless pack of its size. Make a new archive "
            "with `stkzoo assets pack --output`."
        )
