"""The NumPy implementation of ``road_tracer.c``: the line of the road ahead."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from tests.oracle.vectors import line_places, squared

FloatArray = npt.NDArray[np.float32]
DoubleArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[Any]


def trace_roads(
    starts: FloatArray,
    ends: FloatArray,
    widths: FloatArray,
    counts: IntArray,
    rules: DoubleArray,
    lines: FloatArray,
    looks: FloatArray,
    points: FloatArray,
) -> None:
    spacing, touching, longest_jump, tail = rules.tolist()
    for number, count in enumerate(counts.tolist()):
        a, b, c = (part[number, :count] for part in (starts, ends, widths))
        if not count:
            a, b, c = np.zeros((1, 3), "f4"), np.zeros((1, 3), "f4"), np.zeros(1, "f4")
        chain = _chain(a, b, touching, longest_jump)
        corners = np.empty((2 * len(chain) + 1, 3))
        corners[:-1:2], corners[1:-1:2] = a[chain], b[chain]
        last = corners[-2] - corners[-3]
        corners[-1] = corners[-2] + last * (tail / max(float(np.linalg.norm(last)), 1e-3))
        steps = corners[1:] - corners[:-1]
        marks = np.zeros(len(corners))
        np.cumsum(np.sqrt((steps**2).sum(axis=1)), out=marks[1:])
        rooms = np.repeat(c[chain] / 2, 2)
        columns = (*corners.T, np.concatenate([rooms, rooms[-1:]]))
        places = spacing * np.arange(lines.shape[1])
        for number_of_column, column in enumerate(columns):
            lines[number, :, number_of_column] = np.interp(places, marks, column)
        one = slice(number, number + 1)
        _look_along(lines[one], spacing, a[:1], b[:1], looks, points[one])


def _chain(
    starts: FloatArray, ends: FloatArray, touching: float, longest_jump: float
) -> npt.NDArray[np.intp]:
    """Returns the indices of consecutive segments, beginning with the first."""
    count = len(starts)
    jumps = np.abs(starts[1:] - ends[:-1]).max(axis=1) if count > 1 else np.zeros(0)
    if (jumps < touching).all():
        return np.arange(count)
    squares = squared(starts[None, :, :] - ends[:, None, :])
    squares[np.tri(count, dtype=bool)] = np.inf  # successors come later in driving order
    followers = squares.argmin(axis=1).tolist()
    is_last = (squares.min(axis=1) > longest_jump**2).tolist()
    chain = [0]
    while not is_last[chain[-1]]:
        chain.append(followers[chain[-1]])
    return np.array(chain, np.intp)


def _look_along(
    lines: FloatArray,
    spacing: float,
    starts: FloatArray,
    ends: FloatArray,
    looks: FloatArray,
    out: FloatArray,
) -> None:
    before, share = line_places(starts, ends - starts, looks, spacing, lines.shape[1])
    rows = np.arange(len(lines))[:, None]
    here, there = lines[rows, before], lines[rows, before + 1]
    out[:] = here + (there - here) * share[..., None]
