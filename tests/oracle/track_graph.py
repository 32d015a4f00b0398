"""The reference implementation of ``track_graph.c``."""

from __future__ import annotations

import heapq
import itertools
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]


class TrackGraph:
    """A track's segments, and the order of the segments ahead of each one.

    Attributes:
        path_nodes: ``(N, 2, 3)`` float32 [m].
        path_width: ``(N, 1)`` float32 [m].
        path_distance: ``(N, 2)`` float32 [m].

    Args:
        nodes: start and end of each segment [m].
        widths: width of each segment [m].
        distances: distances along the lap from the start line to each segment's start and end [m].
        begins: ``(N + 1,)``: the successors of segment ``n`` are
            ``successors[begins[n] : begins[n + 1]]``.
        successors: numbers of the successors of all segments.
        length: length of a lap [m].

    Raises:
        ValueError: the arrays do not fit together.
    """

    def __init__(
        self,
        nodes: FloatArray,
        widths: FloatArray,
        distances: FloatArray,
        begins: IntArray,
        successors: IntArray,
        length: float,
    ) -> None:
        count = len(begins) - 1
        sizes = nodes.size, widths.size, distances.size
        if (
            count < 1
            or sizes != (6 * count, count, 2 * count)
            or not length > 0
            or begins[0] != 0
            or begins[-1] != len(successors)
            or (np.diff(begins) < 0).any()
            or ((successors < 0) | (successors >= count)).any()
        ):
            raise ValueError("the track's arrays do not fit together")
        self.path_nodes = nodes.reshape(count, 2, 3)
        self.path_width = widths.reshape(count, 1)
        self.path_distance = distances.reshape(count, 2)
        self._successors = [
            successors[begin:end].tolist() for begin, end in itertools.pairwise(begins.tolist())
        ]
        self._begin = self.path_distance[:, 0].tolist()
        self._length = length
        self._orders: dict[int, IntArray] = {}

    def ahead(self, node: int) -> IntArray:
        """Returns all segments in order of driving distance from a segment, ``(N,)``."""
        if not 0 <= node < len(self._begin):
            raise IndexError(f"there is no segment {node}")
        if node not in self._orders:
            self._orders[node] = np.array(self._order_from(node), np.intp)
        order: IntArray = self._orders[node].copy()
        return order

    def nodes_ahead(self, nodes: Any, max_paths: int | None = None) -> IntArray:
        """See :meth:`stkzoo.engine.track.TrackMap.nodes_ahead`."""
        rows = [self.ahead(node)[:max_paths] for node in nodes.tolist()]
        return np.array(rows, np.intp).reshape(len(rows), -1)

    def _order_from(self, start: int) -> list[int]:
        begin = self._begin
        order: list[int] = []
        seen: set[int] = set()
        queue = [(0.0, start)]
        while queue:
            distance, node = heapq.heappop(queue)
            if node in seen:
                continue
            seen.add(node)
            order.append(node)
            for successor in self._successors[node]:
                gap = (begin[successor] - begin[node]) % self._length
                heapq.heappush(queue, (distance + gap, successor))
        unreachable = set(range(len(begin))) - seen
        return order + sorted(unreachable, key=lambda n: (begin[n] - begin[start]) % self._length)
