"""The driving line of a track as arrays, and the order of the segments ahead."""

from __future__ import annotations

import functools
import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from stkzoo._left_out import LeftOutNames
from stkzoo.kernel import TrackGraph

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]

_JSON_SIZE = struct.Struct("<I")


@dataclass(eq=False)
class TrackMap(LeftOutNames):
    """The graph of segments ("nodes") along a track. All arrays are read-only.

    Attributes:
        length: length of a lap [m].
        path_nodes: ``(N, 2, 3)`` float32 [m], world frame: start and end of each
            segment of the center line.
        path_width: ``(N, 1)`` float32: width of the road [m].
        path_distance: ``(N, 2)`` float32: distance from the start line to the start and the end
            of each segment [m].
        successors: the nodes that follow each node; more than one at a fork.
        graph: the same graph in the kernel's form.
    """

    left_out: ClassVar = {"update": "a track does not change"}
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
        """Returns the segments ahead, nearest first in driving distance.

        The driving distance is the shortest path in the graph. A branch that the kart has passed
        is therefore a lap away.

        Args:
            nodes: ``(A,)`` indices of the segments to start from.
            max_paths: maximum number of segments; all by default.

        Returns:
            ``(A, P)`` indices; the first column is ``nodes``.
        """
        rows = [self.graph.ahead(node)[:max_paths] for node in nodes.tolist()]
        return np.array(rows, np.intp).reshape(len(rows), -1)


def encode_track(track: Any) -> bytes:
    """Returns a track as one block of bytes, which :func:`decode_track` decodes.

    Args:
        track: an object with the attributes of a :class:`TrackMap`, such as a ``pystk2.Track``.
    """
    facts = json.dumps({"length": track.length, "successors": track.successors}).encode()
    arrays = track.path_nodes, track.path_width, track.path_distance
    blocks = (np.ascontiguousarray(array, "f4").tobytes() for array in arrays)
    return b"".join([_JSON_SIZE.pack(len(facts)), facts, *blocks])


@functools.lru_cache(maxsize=64)
def decode_track(data: bytes) -> TrackMap:
    """Decodes a block of :func:`encode_track`.

    Args:
        data: the block.

    Returns:
        The track. Results are cached, so equal blocks return the same object.
    """
    (size,) = _JSON_SIZE.unpack_from(data)
    start = _JSON_SIZE.size + size
    facts = json.loads(data[_JSON_SIZE.size : start])
    count = len(facts["successors"])
    numbers = np.frombuffer(data, "f4", offset=start).copy()  # the copy is aligned
    nodes, widths, distances = np.split(numbers, [6 * count, 7 * count])
    return TrackMap(
        facts["length"],
        nodes.reshape(count, 2, 3),
        widths.reshape(count, 1),
        distances.reshape(count, 2),
        facts["successors"],
    )
