"""The ground near a track's driving lines, stored in vertical columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from stkzoo.engine.ground.scenery import Faces, read_scenery
from stkzoo.engine.track import TrackMap
from stkzoo.errors import ConfigError
from stkzoo.names import GroundKind

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]

#: Width of a column [m], and maximum number of ground levels in it.
_CELL, _LEVELS = 0.5, 4
#: Maximum horizontal distance of a column from a driving line, and maximum depth below and height
#: above the line [m].
_REACH, _BELOW, _ABOVE = 14.0, 10.0, 6.0
#: Minimum distance between two levels [m]. Of two closer levels, wheels touch only the upper one.
_APART = 0.5
#: Limits on the absolute vertical component of a face's unit normal: karts can drive on a face
#: above the first, and can collide with a face below the second.
_FLAT, _STEEP = 0.35, 0.8
#: Heights above the ground at which karts collide with faces [m].
_HEIGHTS = (0.45, 0.8)
#: Horizontal directions (x, z) in which walls are searched from the center of a column.
_ACROSS = np.array([[1.0, 0.0], [0.0, 1.0], [0.5**0.5, 0.5**0.5], [0.5**0.5, -(0.5**0.5)]])
#: About how many pairs of a face and a column are processed together.
_CHUNK = 400_000


@dataclass(frozen=True, slots=True)
class Spots:
    """The ground at places in the world, as arrays of shape ``(...)``.

    Attributes:
        kind: uint8, numbers of :class:`~stkzoo.names.GroundKind`.
        height: float32: height in the world frame [m]; NaN where there is no ground.
        speed: float32: maximum speed there as a fraction of a kart's top speed.
    """

    kind: npt.NDArray[np.uint8]
    height: npt.NDArray[np.float32]
    speed: npt.NDArray[np.float32]


class Ground:
    """The ground and walls near a track's driving lines.

    Args:
        faces: the solid faces of the track.
        line: ``(N, 3)`` points of the driving lines [m], world frame, at most one meter apart.
    """

    def __init__(self, faces: Faces, line: npt.NDArray[np.floating]) -> None:
        near = _Near(np.asarray(line, np.float64))
        self._near = near
        self._heights = np.full((_LEVELS, *near.shape), np.inf, np.float32)  # infinity: no ground
        self._kinds = np.zeros(self._heights.shape, np.uint8)
        self._speeds = np.ones(self._heights.shape, np.float32)
        corners = faces.corners.astype(np.float64)
        normals = _normals(corners)
        flatness = np.abs(normals[:, 1])
        self._lay(faces, corners, np.flatnonzero(flatness > _FLAT))
        self._raise_walls(corners, normals, np.flatnonzero(flatness < _STEEP))

    def at(self, places: npt.NDArray[np.floating], reach: float = 3.0) -> Spots:
        """Returns the ground at places.

        Args:
            places: ``(..., 3)`` [m], world frame.
            reach: ground this far above or below a place, or farther, is ignored [m].

        Raises:
            ConfigError: the places have a wrong shape or are not finite.
        """
        spots: FloatArray = np.asarray(places, np.float64)
        if spots.shape[-1:] != (3,) or not np.isfinite(spots).all():
            raise ConfigError(
                f"places have the shape {spots.shape}, expected finite numbers (..., 3): x, y and "
                "z in the world [m]"
            )
        rows, columns, is_inside = self._near.cells(spots)
        top = rows * self._near.shape[1] + columns
        at, apart = top, np.full(top.shape, np.inf)
        for first in range(0, self._heights.size, self._heights[0].size):
            level = top + first
            height_apart = np.abs(self._heights.take(level) - spots[..., 1])
            is_nearer = height_apart < apart
            at, apart = np.where(is_nearer, level, at), np.where(is_nearer, height_apart, apart)
        is_there = is_inside & (apart < reach)
        return Spots(
            np.where(is_there, self._kinds.take(at), np.uint8(GroundKind.VOID)),
            np.where(is_there, self._heights.take(at), np.float32(np.nan)),
            np.where(is_there, self._speeds.take(at), np.float32(1.0)),
        )

    def _lay(self, faces: Faces, corners: FloatArray, flat: IntArray) -> None:
        """Adds the faces that karts can drive on to the columns."""
        near, pairs, at_heights = self._near, [], []
        for who, rows, columns in near.pairs(corners, flat, 0.0):
            heights = _heights(corners[who], near.middles(rows, columns))
            is_kept = near.is_level(rows, columns, heights)
            pairs.append(np.stack([who, rows * near.shape[1] + columns])[:, is_kept])
            at_heights.append(heights[is_kept])
        (who, cell), height = np.concatenate(pairs, axis=1), np.concatenate(at_heights)
        order = np.lexsort((-height, cell))
        who, cell, height = who[order], cell[order], height[order]
        is_hidden = np.zeros(len(cell), bool)
        is_hidden[1:] = (np.diff(cell) == 0) & (height[:-1] - height[1:] < _APART)
        who, cell, height = who[~is_hidden], cell[~is_hidden], height[~is_hidden]
        level = np.arange(len(cell)) - np.searchsorted(cell, cell)
        is_kept = level < _LEVELS
        who, height = who[is_kept], height[is_kept]
        at = (level[is_kept], *np.divmod(cell[is_kept], near.shape[1]))
        self._heights[at] = height
        self._speeds[at] = faces.speed[who]
        self._kinds[at] = np.select(
            [faces.is_reset[who], faces.is_zipper[who], faces.speed[who] < 1.0],
            [GroundKind.VOID, GroundKind.ZIPPER, GroundKind.SLOWED],
            GroundKind.GROUND,
        )

    def _raise_walls(self, corners: FloatArray, normals: FloatArray, steep: IntArray) -> None:
        """Marks the levels on which karts collide with a face."""
        near = self._near
        low, high = corners[..., 1].min(1), corners[..., 1].max(1)
        for who, rows, columns in near.pairs(corners, steep, _CELL / 2):
            for level in range(_LEVELS):
                heights = self._heights[level, rows, columns]
                for above in _HEIGHTS:
                    at = heights + above
                    hit = np.flatnonzero((at > low[who]) & (at < high[who]))
                    is_wall = _crosses(
                        corners[who[hit]],
                        normals[who[hit]],
                        near.middles(rows[hit], columns[hit]),
                        at[hit].astype(np.float64),
                    )
                    hit = hit[is_wall]
                    self._kinds[level, rows[hit], columns[hit]] = GroundKind.WALL


class _Near:
    """The columns near the driving lines.

    Attributes:
        shape: number of rows (along x) and columns (along z).
    """

    def __init__(self, line: FloatArray) -> None:
        flat = line[:, [0, 2]]
        self._corner = flat.min(0) - _REACH - _CELL
        most = flat.max(0) + _REACH + _CELL
        self.shape = tuple(np.ceil((most - self._corner) / _CELL).astype(int).tolist())
        self._lowest = np.full(self.shape, np.inf)
        self._highest = np.full(self.shape, -np.inf)
        cells = np.arange(-int(_REACH / _CELL), int(_REACH / _CELL) + 1)
        disc = np.argwhere(cells[:, None] ** 2 + cells**2 <= (_REACH / _CELL) ** 2) + cells[0]
        line_cells = ((flat - self._corner) / _CELL).astype(np.intp)
        for spot, height in zip(line_cells, line[:, 1], strict=True):
            rows, columns = (spot + disc).T
            self._lowest[rows, columns] = np.minimum(self._lowest[rows, columns], height)
            self._highest[rows, columns] = np.maximum(self._highest[rows, columns], height)
        self._count = np.zeros((self.shape[0] + 1, self.shape[1] + 1), np.intp)
        self._count[1:, 1:] = np.isfinite(self._lowest).cumsum(0).cumsum(1)

    def cells(self, places: FloatArray) -> tuple[IntArray, IntArray, BoolArray]:
        """Returns rows, columns and whether they exist, for places ``(..., 3)`` [m]."""
        exact = np.floor((places[..., [0, 2]] - self._corner) / _CELL)
        cell = np.clip(exact, 0, np.array(self.shape) - 1).astype(np.intp)
        is_inside = (cell == exact).all(-1)
        return cell[..., 0], cell[..., 1], is_inside

    def middles(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Returns the centers of columns, ``(P, 2)``: x and z [m], world frame."""
        middles: FloatArray = self._corner + (np.stack([rows, columns], axis=1) + 0.5) * _CELL
        return middles

    def is_level(self, rows: IntArray, columns: IntArray, heights: FloatArray) -> BoolArray:
        """Returns whether heights [m] are near those of the driving lines."""
        is_level: BoolArray = heights > self._lowest[rows, columns] - _BELOW
        is_level &= heights < self._highest[rows, columns] + _ABOVE
        return is_level

    def pairs(
        self, corners: FloatArray, who: IntArray, margin: float
    ) -> Iterator[tuple[IntArray, IntArray, IntArray]]:
        """Yields candidate pairs of a face and a column whose center it may cover, in chunks.

        Args:
            corners: ``(F, 3, 3)`` corners of all faces [m].
            who: indices of the faces to use.
            margin: maximum distance between a column's center and a face's bounding box [m].

        Yields:
            Indices of the faces, rows and columns of the pairs.
        """
        flat = corners[who][:, :, [0, 2]]
        low, high = ((part - self._corner) / _CELL for part in (flat.min(1), flat.max(1)))
        reach = margin / _CELL
        first = np.clip(np.ceil(low - reach - 0.5).astype(np.intp), 0, self.shape)
        end = np.clip(np.floor(high + reach + 0.5).astype(np.intp), first, self.shape)
        sizes = end - first
        near = self._count[end[:, 0], end[:, 1]] - self._count[first[:, 0], end[:, 1]]
        near += self._count[first[:, 0], first[:, 1]] - self._count[end[:, 0], first[:, 1]]
        matters = np.flatnonzero((near > 0) & sizes.all(1))
        who, first, sizes = who[matters], first[matters], sizes[matters]
        counts = sizes.prod(1)
        chunk = np.cumsum(counts) // _CHUNK
        for part in np.split(np.arange(len(who)), np.flatnonzero(np.diff(chunk)) + 1):
            face = np.repeat(part, counts[part])
            begins = np.cumsum(counts[part]) - counts[part]
            place = np.arange(len(face)) - np.repeat(begins, counts[part])
            rows = first[face, 0] + place // sizes[face, 1]
            columns = first[face, 1] + place % sizes[face, 1]
            is_near = np.isfinite(self._lowest[rows, columns])
            yield who[face[is_near]], rows[is_near], columns[is_near]


def _normals(corners: FloatArray) -> FloatArray:
    """Returns the unit normals of faces; NaN for faces without an area."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    with np.errstate(invalid="ignore", divide="ignore"):
        unit: FloatArray = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return unit


def _heights(corners: FloatArray, middles: FloatArray) -> FloatArray:
    """Returns the heights ``(P,)`` of faces ``(P, 3, 3)`` at places ``(P, 2)`` [m].

    The height is NaN where the face does not cover the place.
    """
    a, b, c = (corners[:, n][:, [0, 2]] for n in range(3))
    one, other, place = b - a, c - a, middles - a
    area = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        second = (place[:, 0] * other[:, 1] - place[:, 1] * other[:, 0]) / area
        third = (one[:, 0] * place[:, 1] - one[:, 1] * place[:, 0]) / area
    first = 1.0 - second - third
    heights = first * corners[:, 0, 1] + second * corners[:, 1, 1] + third * corners[:, 2, 1]
    edge = -1e-6
    is_over = (first >= edge) & (second >= edge) & (third >= edge)
    return np.where(is_over, heights, np.nan)


def _crosses(
    corners: FloatArray, normals: FloatArray, middles: FloatArray, heights: FloatArray
) -> BoolArray:
    """Returns whether faces ``(P, 3, 3)`` cross the columns ``(P, 2)`` at heights ``(P,)`` [m]."""
    middle = np.stack([middles[:, 0], heights, middles[:, 1]], axis=1)
    gap = ((corners[:, 0] - middle) * normals).sum(1)
    crosses = np.zeros(len(corners), bool)
    for x, z in _ACROSS:
        way = np.array([x, 0.0, z]) * (_CELL / 2)
        slope = normals @ way
        who = np.flatnonzero(np.abs(gap) <= np.abs(slope))
        who = who[slope[who] != 0]
        meets = middle[who] + (gap[who] / slope[who])[:, None] * way
        crosses[who] |= _is_in(corners[who], normals[who], meets)
    return crosses


def _is_in(corners: FloatArray, normals: FloatArray, spots: FloatArray) -> BoolArray:
    """Returns whether points in the planes of faces are inside the faces."""
    is_in = np.ones(len(spots), bool)
    for n in range(3):
        edge = corners[:, (n + 1) % 3] - corners[:, n]
        is_in &= (np.cross(edge, spots - corners[:, n]) * normals).sum(1) >= -1e-6
    return is_in


#: Maximum distance between two points of a driving line [m].
_SPACING = 1.0


@lru_cache(maxsize=64)
def ground_of(track: TrackMap, name: str, root: Path, *, reverse: bool = False) -> Ground:
    """Returns the ground near a track's driving lines.

    The result is cached; the first call for a track takes 0.2 to 2 s.

    Args:
        track: the segments of the track.
        name: name of the track.
        root: folder of the game's data, :attr:`~stkzoo.engine.assets.Assets.root`.
        reverse: whether the race is in reverse.

    Raises:
        AssetError: a file is missing or broken.
    """
    return Ground(read_scenery(root / "data", name, reverse=reverse), _line(track))


def _line(track: TrackMap) -> npt.NDArray[np.float64]:
    """Returns points on the center lines of all segments, ``(N, 3)`` [m]."""
    pieces = []
    for start, end in track.path_nodes.astype(np.float64):
        count = max(int(np.linalg.norm(end - start) / _SPACING) + 1, 2)
        pieces.append(np.linspace(start, end, count))
    return np.concatenate(pieces)
