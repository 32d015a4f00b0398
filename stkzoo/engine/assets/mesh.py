"""A reader of the game's meshes, ``.spm`` files.

A file contains, in little-endian order: ``SP``; a byte with the version (upper five bits, 1) and
the kind (lower three bits, 1: with joints); a byte of flags (1: normals, 2: colors, 4: tangents);
a bounding box of six floats; the materials, with two texture names each; and the parts.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from stkzoo.errors import AssetError

_VERSION, _WITH_JOINTS = 1, 1
_NORMALS, _COLORS, _TANGENTS = 1, 2, 4
_BOX = 24
#: First byte of a color that is white and has no further bytes. Other colors have three more.
_WHITE = 128


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a mesh, with one material.

    Attributes:
        texture: file name of the material's first texture; empty if it has none.
        vertices: ``(N, 3)`` float32 [m].
        triangles: ``(M, 3)`` indices into ``vertices``.
    """

    texture: str
    vertices: npt.NDArray[np.float32]
    triangles: npt.NDArray[np.intp]


class _MeshReader:
    """Reads values from bytes, one after another."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, layout: str) -> tuple[int, ...]:
        values = struct.unpack_from("<" + layout, self.data, self.at)
        self.at += struct.calcsize("<" + layout)
        return values

    def count(self) -> int:
        (number,) = self.take("H")
        return number

    def text(self) -> str:
        (length,) = self.take("B")
        self.at += length
        return self.data[self.at - length : self.at].decode("latin-1")


def read_mesh(path: str | Path) -> list[Part]:
    """Reads the parts of a mesh.

    Args:
        path: the ``.spm`` file.

    Raises:
        AssetError: the file is missing, broken or of another version.
    """
    with _reading(path) as file:
        textures = _textures(file)
        return [_part(file, textures) for _ in range(file.count()) for _ in range(file.count())]


def read_textures(path: str | Path) -> list[str]:
    """Reads the file names of the first textures of a mesh's materials.

    Args:
        path: the ``.spm`` file.

    Raises:
        AssetError: the file is missing, broken or of another version.
    """
    with _reading(path) as file:
        return [first for first, _ in _textures(file)]


@contextlib.contextmanager
def _reading(path: str | Path) -> Iterator[_MeshReader]:
    try:
        yield _MeshReader(Path(path).read_bytes())
    except (OSError, ValueError, struct.error, IndexError) as error:
        raise AssetError(f"{str(path)!r} is not a mesh that can be read: {error}") from error


def _textures(file: _MeshReader) -> list[tuple[str, str]]:
    """Returns the names of both textures of each material; the parts follow in the file."""
    magic, version = file.data[:2], file.data[2]
    if magic != b"SP" or version >> 3 != _VERSION:
        raise ValueError(f"it begins with {file.data[:3]!r}, expected 'SP' and version {_VERSION}")
    file.at = 4 + _BOX
    return [(file.text(), file.text()) for _ in range(file.count())]


def _part(file: _MeshReader, textures: list[tuple[str, str]]) -> Part:
    has_joints, flags = file.data[2] & 7 == _WITH_JOINTS, file.data[3]
    vertices, indices, material = file.take("IIH")
    first, second = textures[material]
    before = 12 + 4 * bool(flags & _NORMALS)
    after = bool(first) * (4 + 4 * bool(second) + 4 * bool(flags & _TANGENTS)) + 16 * has_joints
    starts = _starts(file, vertices, before, after, with_colors=bool(flags & _COLORS))
    raw = np.frombuffer(file.data, np.uint8)
    corners = raw[starts[:, None] + np.arange(12)].copy().view("<f4")
    triangles = np.frombuffer(file.data, "<u2" if vertices > 255 else "u1", indices, file.at)
    file.at += triangles.nbytes
    shaped = triangles.astype(np.intp).reshape(-1, 3)
    if len(shaped) and shaped.max() >= vertices:
        raise ValueError(f"a triangle has the corner {shaped.max()} of {vertices}")
    return Part(first, corners.astype(np.float32), shaped)


def _starts(
    file: _MeshReader, count: int, before: int, after: int, *, with_colors: bool
) -> npt.NDArray[np.intp]:
    """Returns the byte offsets of vertices. Vertices that are not white are longer than others."""
    if not with_colors:
        begin, size = file.at, before + after
        file.at += count * size
        return begin + size * np.arange(count)
    starts = np.empty(count, np.intp)
    at = file.at
    for vertex in range(count):
        starts[vertex] = at
        at += before + (1 if file.data[at + before] == _WHITE else 4) + after
    file.at = at
    return starts
