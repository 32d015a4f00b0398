"""The track's main line as a curve, and turns in the world."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Road", "rotation_of", "turned"]

FloatArray = npt.NDArray[np.float64]


class Road:
    """The track's main line as a curve over the distance from the start line.

    Attributes:
        length: of a lap [m].

    Args:
        track: the engine's track.
    """

    def __init__(self, track: Any) -> None:
        self.length = float(track.length)
        nodes = np.asarray(track.path_nodes, np.float64)
        marks = np.asarray(track.path_distance, np.float64)
        widths = np.asarray(track.path_width, np.float64).reshape(-1)
        chain = _main_line(track.successors)
        self._marks = marks[chain].ravel()
        self._points = nodes[chain].reshape(-1, 3)
        self._half_widths = np.repeat(widths[chain] / 2, 2)
        order = np.argsort(self._marks, kind="stable")
        self._marks, self._points = self._marks[order], self._points[order]
        self._half_widths = self._half_widths[order]

    def point(self, distance: float) -> FloatArray:
        """The centre line ``(3,)`` [m] at a distance [m]."""
        mark = distance % self.length
        return np.array([np.interp(mark, self._marks, column) for column in self._points.T])

    def half_width(self, distance: float) -> float:
        """From the centre line to the road's edge [m]."""
        return float(np.interp(distance % self.length, self._marks, self._half_widths))

    def direction(self, distance: float) -> FloatArray:
        """Where the road leads, a unit vector ``(3,)``."""
        mark = distance % self.length
        row = int(np.clip(np.searchsorted(self._marks, mark, "right"), 1, len(self._marks) - 1))
        while row > 1 and np.linalg.norm(self._points[row] - self._points[row - 1]) < 0.05:
            row -= 1
        along: FloatArray = self._points[row] - self._points[row - 1]
        unit: FloatArray = along / max(float(np.linalg.norm(along)), 1e-9)
        return unit


def _main_line(successors: Any) -> list[int]:
    """The nodes of the main road, from the start line on."""
    chain, node = [], 0
    while node not in chain:
        chain.append(node)
        node = successors[node][0]
    return chain


def rotation_of(yaw: float, climb: float) -> list[float]:
    """A quaternion x, y, z, w: turned to ``yaw``, then the nose up by ``climb``."""
    sy, cy = math.sin(yaw / 2), math.cos(yaw / 2)
    sp, cp = math.sin(-climb / 2), math.cos(-climb / 2)
    return [cy * sp, sy * cp, -sy * sp, cy * cp]


def turned(rotation: list[float], angle: float) -> list[float]:
    """A rotation after a turn about the kart's own upright axis."""
    x, y, z, w = rotation
    s, c = math.sin(angle / 2), math.cos(angle / 2)
    return [x * c - z * s, y * c + w * s, z * c + x * s, w * c - y * s]
