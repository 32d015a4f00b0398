"""The ground of a track that is driven on here."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from stkzoo.engine.ground.columns import Ground
from stkzoo.engine.ground.scenery import read_scenery
from stkzoo.engine.track import TrackMap

__all__ = ["ground_of"]

#: Points of the driving lines are so far apart [m].
_SPACING = 1.0


@lru_cache(maxsize=64)
def ground_of(track: TrackMap, name: str, root: Path, *, reverse: bool = False) -> Ground:
    """What is near a track's driving lines; takes 1 to 7 s the first time in a program.

    Args:
        track: its segments.
        name: its name.
        root: of the game's data, :attr:`~stkzoo.engine.assets.Assets.root`.
        reverse: whether they lead the other way round.

    Raises:
        AssetError: a file is missing or broken.
    """
    return Ground(read_scenery(root / "data", name, reverse=reverse), _line(track))


def _line(track: TrackMap) -> npt.NDArray[np.float64]:
    """Points of all segments, ``(N, 3)`` [m]."""
    pieces = []
    for start, end in track.path_nodes.astype(np.float64):
        count = max(int(np.linalg.norm(end - start) / _SPACING) + 1, 2)
        pieces.append(np.linspace(start, end, count))
    return np.concatenate(pieces)
