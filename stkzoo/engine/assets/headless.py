"""The headless pack: what a race needs of the game's data, without what one sees.

Every picture, piece of music and sound is replaced by a tiny one of the same name. None
may be missing: the game derives the properties of the ground from its materials, and a
material whose picture or sound is not there changes how karts drive on it. Races are bit
for bit those of the full data.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from stkzoo.engine.assets.progress import Progress
from stkzoo.engine.assets.staging import check_space, link_or_copy
from stkzoo.engine.assets.tree import check_files, write_marker

__all__ = ["build_headless", "placeholder_jpeg", "placeholder_png"]

_SOUND = {".flac", ".mp3", ".oga", ".ogg", ".wav"}
_JPEG = {".jpeg", ".jpg"}

_SIDE = 4


def placeholder_png() -> bytes:
    """A grey picture of 4x4 pixels as a PNG file."""
    header = struct.pack(">IIBBBBB", _SIDE, _SIDE, 8, 2, 0, 0, 0)
    row = b"\x00" + b"\x80" * 3 * _SIDE
    body = zlib.compress(row * _SIDE, 9)
    chunks = ((b"IHDR", header), (b"IDAT", body), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_png_chunk(kind, data) for kind, data in chunks)


def _png_chunk(kind: bytes, data: bytes) -> bytes:
    crc = struct.pack(">I", zlib.crc32(kind + data))
    return struct.pack(">I", len(data)) + kind + data + crc


def placeholder_jpeg() -> bytes:
    """A grey picture of 4x4 pixels as a baseline JPEG file.

    Each Huffman table holds one code of one bit, for a zero difference and for the end
    of a block, so that the picture of three components is six zero bits.
    """
    quantization = _jpeg_segment(0xDB, b"\x00" + b"\x01" * 64)
    components = b"".join(bytes((number, 0x11, 0)) for number in (1, 2, 3))
    frame = _jpeg_segment(0xC0, struct.pack(">BHHB", 8, _SIDE, _SIDE, 3) + components)
    one_code = b"\x01" + b"\x00" * 15 + b"\x00"
    tables = _jpeg_segment(0xC4, b"\x00" + one_code + b"\x10" + one_code)
    scan = _jpeg_segment(0xDA, b"\x03" + b"\x01\x00\x02\x00\x03\x00" + b"\x00\x3f\x00")
    jfif = _jpeg_segment(0xE0, b"JFIF\x00\x01\x01\x00\x00\x01\x00\x01\x00\x00")
    return b"\xff\xd8" + jfif + quantization + frame + tables + scan + b"\x03" + b"\xff\xd9"


def _jpeg_segment(marker: int, data: bytes) -> bytes:
    return bytes((0xFF, marker)) + struct.pack(">H", len(data) + 2) + data


def build_headless(source: Path, target: Path, progress: Progress) -> None:
    """Makes the headless pack of a full tree.

    Files are shared with the source by hard links where the file system allows it, so
    that the pack takes little room beside full data of ours.

    Args:
        source: root of the full tree.
        target: an empty folder, which becomes the root of the pack.
        progress: told about it.

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
        contents = {"png": placeholder_png(), "jpeg": placeholder_jpeg()}
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
