"""The headless pack: the game's data without pictures and sounds, as a folder or one file.

A tiny file of the same name replaces every picture, piece of music and sound. None may be
missing: the game derives the properties of the ground from its materials, and a material
without its picture or sound changes how karts drive on it. Races are bit for bit those of
the full data. The pack as one archive is for clusters and containers.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import io
import os
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from lzma import LZMAError
from pathlib import Path, PurePosixPath
from typing import Final

from stkzoo._os import file_digest, write_whole
from stkzoo.engine.assets.staging import Progress, check_space, link_or_copy
from stkzoo.engine.assets.tree import MARKER, check_files, read_marker, write_marker
from stkzoo.errors import AssetError

_SOUND = {".flac", ".mp3", ".oga", ".ogg", ".wav"}
_JPEG = {".jpeg", ".jpg"}

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
    placeholders = _Placeholders(target, [path for path, _ in files])
    done = 0
    for path, size in files:
        goal = target / "data" / path.relative_to(source / "data")
        kind = _kind(path)
        goal.parent.mkdir(parents=True, exist_ok=True)
        if kind == "keep":
            link_or_copy(path, goal)
            done += size
            progress.reach(done)
        else:
            placeholders.put(kind, goal)
    placeholders.finish()
    write_marker(target, "headless pack", headless=True)


def _files(data: Path) -> Iterator[tuple[Path, int]]:
    for folder, _, names in os.walk(data, followlinks=True):
        for name in names:
            path = Path(folder, name)
            if path.is_file():
                yield path, path.stat().st_size


def _kind(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix in _SOUND:
        return "sound"
    if suffix in _JPEG:
        return "jpeg"
    return "png" if suffix == ".png" else "keep"


class _Placeholders:
    """One small file of each kind, linked under every name that needs it.

    The sound is the smallest of the game's own.
    """

    def __init__(self, root: Path, files: list[Path]) -> None:
        contents = {"png": PLACEHOLDER_PNG, "jpeg": PLACEHOLDER_JPEG}
        sounds = [path for path in files if _kind(path) == "sound"]
        if sounds:
            smallest = min(sounds, key=lambda path: (path.stat().st_size, path.name))
            contents["sound"] = smallest.read_bytes()
        self._files = {kind: root / f".{kind}" for kind in contents}
        for kind, content in contents.items():
            self._files[kind].write_bytes(content)

    def put(self, kind: str, goal: Path) -> None:
        link_or_copy(self._files[kind], goal)

    def finish(self) -> None:
        for file in self._files.values():
            file.unlink()


#: First member of an archive: lines that ``sha256sum --check`` understands.
SUMS = "SHA256SUMS"

_PRESET: Final = 6

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
    names = sorted(path.relative_to(root).as_posix() for path in _regular_files(root))
    sums = "".join(f"{file_digest(root / name, hashlib.sha256())}  {name}\n" for name in names)
    with write_whole(file, "the archive", AssetError) as part:
        _write_members(root, names, sums.encode(), part, progress)


def _regular_files(root: Path) -> Iterator[Path]:
    yield root / MARKER
    yield from (path for path in (root / "data").rglob("*") if path.is_file())


def _write_members(
    root: Path, names: list[str], sums: bytes, file: Path, progress: Progress
) -> None:
    progress.begin("writing the archive", sum((root / name).stat().st_size for name in names))
    done = 0
    with tarfile.open(file, "w:xz", preset=_PRESET, format=tarfile.PAX_FORMAT) as archive:
        archive.addfile(_member(SUMS, len(sums)), io.BytesIO(sums))
        for name in names:
            path = root / name
            size = path.stat().st_size
            with path.open("rb") as stream:
                archive.addfile(_member(name, size), stream)
            done += size
            progress.reach(done)


def _member(name: str, size: int) -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    member.size, member.mode, member.mtime = size, 0o644, 0
    return member


def read_archive(file: Path, target: Path, progress: Progress) -> None:
    """Unpacks what :func:`write_archive` made, and checks every byte of it.

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
        _read_members(file, target, progress)
        check_files(target)
        marker = read_marker(target)
    except (tarfile.TarError, LZMAError, EOFError, UnicodeError) as error:
        raise AssetError(
            f"{file} is broken or no archive of `stkzoo assets pack --output`: {error}. "
            f"Copy it again, or make a new one."
        ) from error
    except OSError as error:
        raise AssetError(f"{file} cannot be unpacked: {error}.") from error
    if marker is None or not marker.headless:
        raise AssetError(f"{file} holds no headless pack.")


def _read_members(file: Path, target: Path, progress: Progress) -> None:
    with file.open("rb") as raw, tarfile.open(fileobj=raw, mode="r:xz") as archive:
        first = archive.next()
        if first is None or first.name != SUMS:
            raise AssetError(f"{file} is no archive of `stkzoo assets pack --output`.")
        unpacker = _Unpacker(target, _parse_sums(_content(archive, first).decode()))
        for member in archive:
            if member.name != SUMS:
                unpacker.take(member, archive)
                progress.reach(raw.tell())
        unpacker.finish()


def _content(archive: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    stream = archive.extractfile(member) if member.isreg() else None
    if stream is None or member.size > _LARGEST:
        raise AssetError(f"the archive's member {member.name!r} is no plain file of ours.")
    return stream.read()


def _parse_sums(text: str) -> dict[str, str]:
    lines = (line.split("  ", 1) for line in text.splitlines())
    try:
        return {name: digest for digest, name in lines}
    except ValueError as error:
        raise AssetError(f"the archive's {SUMS} is damaged.") from error


@dataclass
class _Unpacker:
    """Writes members that the list of sums names, each once, with the right content."""

    target: Path
    sums: dict[str, str]
    total: int = 0
    taken: set[str] = field(default_factory=set)
    same: dict[str, Path] = field(default_factory=dict)

    def take(self, member: tarfile.TarInfo, archive: tarfile.TarFile) -> None:
        name = member.name
        self._check(member)
        self.total += member.size
        content = _content(archive, member)
        digest = hashlib.sha256(content).hexdigest()
        if digest != self.sums[name]:
            raise AssetError(f"the archive's {name!r} is damaged: its sum does not agree.")
        self._write(self.target / name, content, digest)
        self.taken.add(name)

    def _check(self, member: tarfile.TarInfo) -> None:
        name = member.name
        path = PurePosixPath(name)
        outside = path.is_absolute() or ".." in path.parts or any(sign in name for sign in "\\:\0")
        if outside or not path.parts or path.parts[0] not in ("data", MARKER):
            raise AssetError(f"the archive's member {name!r} would lie outside the pack.")
        if name not in self.sums or name in self.taken:
            raise AssetError(f"the archive's member {name!r} is not in its list, or comes twice.")
        if self.total + member.size > _LARGEST:
            raise AssetError(f"the archive unpacks to more than {_LARGEST / 1e9:.0f} GB.")

    def _write(self, goal: Path, content: bytes, digest: str) -> None:
        goal.parent.mkdir(parents=True, exist_ok=True)
        earlier = self.same.setdefault(digest, goal)
        if earlier != goal:
            with contextlib.suppress(OSError):
                os.link(earlier, goal)
                return
        goal.write_bytes(content)

    def finish(self) -> None:
        missing = sorted(set(self.sums) - self.taken)
        if missing:
            raise AssetError(f"the archive lacks {len(missing)} files, such as {missing[0]!r}.")
