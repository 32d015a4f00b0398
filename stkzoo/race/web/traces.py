"""What the page's charts show: a few numbers of every kart at every step."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["COLUMNS", "TraceLog"]

#: ``gap`` is the way behind the leader [m]; ``throttle`` is the acceleration, 0 to 1, or -1
#: while the kart brakes; ``reward`` is the sum since the start.
COLUMNS = ("speed", "rank", "gap", "reward", "steer", "throttle")

FloatArray = npt.NDArray[np.float32]


class TraceLog:
    """The past of a race in bounded memory. One thread adds, others read.

    Once it is full, every second entry goes, and from then on every second is kept.

    Args:
        most: how many steps it holds.
    """

    def __init__(self, most: int = 3000) -> None:
        self._lock = threading.Lock()
        self._most, self._stride = most, 1
        self._steps: list[int] = []
        self._rows: list[FloatArray] = []

    def add(self, step: int, row: FloatArray) -> None:
        """Adds a step.

        Args:
            step: its number.
            row: ``(C, K)`` float32, in the order of :data:`COLUMNS`.
        """
        if step % self._stride:
            return
        with self._lock:
            self._steps.append(step)
            self._rows.append(row)
            if len(self._steps) > self._most:
                self._stride *= 2
                kept = [n for n, known in enumerate(self._steps) if known % self._stride == 0]
                self._steps = [self._steps[n] for n in kept]
                self._rows = [self._rows[n] for n in kept]

    def since(self, step: int) -> dict[str, Any]:
        """The steps after one, for JSON; ``steps`` is empty if there are none."""
        with self._lock:
            first = int(np.searchsorted(self._steps, step, side="right"))
            steps, rows = self._steps[first:], self._rows[first:]
        if not rows:
            return {"steps": []}
        values = np.nan_to_num(np.stack(rows, axis=1).astype(np.float64)).round(3)
        columns = dict(zip(COLUMNS, values.tolist(), strict=True))
        return {"steps": steps, "values": columns}
