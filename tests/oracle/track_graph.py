"""The Python implementation of ``track_graph.c``."""

from __future__ import annotations

import heapq
import itertools
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]


class TrackGraph:
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
        if node not in self._orders:
            self._orders[node] = np.array(self._order_from(node), np.intp)
        order: IntArray = self._orders[node].copy()
        return order

    def nodes_ahead(self, nodes: Any, max_paths: int | None = None) -> IntArray:
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
