"""The twin of ``racing_observer.c``."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.wrappers.racing.features import racing_features
from stkzoo.wrappers.racing.surroundings import surroundings_in

FloatArray = npt.NDArray[np.float32]


class RacingObserver:
    """The view ``racing`` on a track.

    Args:
        road: ``lines``, ``starts`` and ``along`` of a
            :class:`~stkzoo.wrappers.racing.RoadTable`.
        tables: the constants of :mod:`stkzoo.wrappers.racing.features`, as for ``counts`` and
            ``lengths``; the twin's formulas have them from there.
        counts: likewise.
        lengths: likewise.
    """

    def __init__(
        self,
        road: tuple[FloatArray, FloatArray, FloatArray],
        tables: tuple[Any, ...],
        counts: tuple[int, ...],
        lengths: tuple[float, ...],
    ) -> None:
        del tables, counts, lengths
        lines, starts, along = road
        if not len(lines) == len(starts) == len(along) or not len(lines):
            raise ValueError("the road's arrays do not fit together")
        self._road = road

    def observe(
        self,
        data: bytes,
        who: npt.NDArray[np.intp],
        out: FloatArray,
        rows: npt.NDArray[np.intp] | None = None,
    ) -> None:
        """Writes the view of each kart of ``who`` into its row of ``out``, by default in order."""
        first = np.zeros(1, np.intp)
        where = slice(None) if rows is None else rows
        out[where] = racing_features(*surroundings_in(self._road, [Snapshot(data)], first, [who]))
