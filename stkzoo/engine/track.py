"""A track's driving line as arrays, and the order of the segments ahead."""

from __future__ import annotations

import functools
import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.kernel import TrackGraph

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]

_JSON_SIZE = struct.Struct("<I")


@dataclass(eq=False)
class TrackMap:
    """The graph of segments ("nodes") along a track. All arrays are read-only.

    Attributes:
        length: length of a lap [m].
        path_nodes: ``(N, 2, 3)`` float32 [m], world frame: start and end of each
            segment of the centre line.
        path_width: ``(N, 1)`` float32 [m].
        path_distance: ``(N, 2)`` float32 [m]: distance from the start line to each
            segment's start and end.
        successors: for each node, the nodes that follow it; more than one at a fork.
        graph: the same as the kernel has it.
    """

    length: float
    path_nodes: FloatArray
    path_width: FloatArray
    path_distance: FloatArray
    successors: Sequence[Sequence[int]]

    def __post_init__(self) -> None:
        arrays = self.path_nodes, self.path_width, self.path_distance
        for array in arrays:
            array.flags.writeable = False
        begins = np.cumsum([0, *map(len, self.successors)], dtype=np.intp)
        successors = np.array([node for nodes in self.successors for node in nodes], np.intp)
        self.graph = TrackGraph(*arrays, begins, successors, self.length)

    @property
    def num_nodes(self) -> int:
        """Number of segments, N."""
        return len(self.successors)

    def nodes_ahead(self, nodes: IntArray, max_paths: int | None = None) -> IntArray:
        """The segments ahead, nearest first along the way a kart can drive.

        The distance is that of the shortest way over the graph, so a branch that the kart has
        passed comes a lap later than its own.

        Args:
            nodes: ``(A,)`` segments to start from.
            max_paths: number of segments; all by default.

        Returns:
            ``(A, P)`` indices; the first column is ``nodes``.
        """
        rows = [self.graph.ahead(node)[:max_paths] for node in nodes.tolist()]
        return np.array(rows, np.intp).reshape(len(rows), -1)


def encode_track(track: Any) -> bytes:
    """A track as one block of bytes, for :func:`decode_track`.

    Args:
        track: has the attributes of a :class:`TrackMap`, as a ``pystk2.Track`` does.
    """
    facts = json.dumps({"length": track.length, "successors": track.successors}).encode()
    arrays = track.path_nodes, track.path_width, track.path_distance
    blocks = (np.ascontiguousarray(array, "f4").tobytes() for array in arrays)
    return b"".join([_JSON_SIZE.pack(len(facts)), facts, *blocks])


@functools.lru_cache(maxsize=64)
def decode_track(data: bytes) -> TrackMap:
    """Reads a block of :func:`encode_track`; equal blocks share one :class:`TrackMap`."""
    (size,) = _JSON_SIZE.unpack_from(data)
    start = _JSON_SIZE.size + size
    facts = json.loads(data[_JSON_SIZE.size : start])
    count = len(facts["successors"])
    numbers = np.frombuffer(data, "f4", offset=start).copy()  # aligned
    nodes, widths, distances = np.split(numbers, [6 * count, 7 * count])
    shaped = nodes.reshape(count, 2, 3), widths.reshape(count, 1), distances.reshape(count, 2)
    return TrackMap(facts["length"], *shaped, facts["successors"])
