"""Observations of several karts in the ``full`` view, in batch form.

Every key of :func:`stkzoo.mdp.spaces.kart_observation_space` has a leading axis of A karts;
sequences are rectangular ``(A, M, ...)`` arrays. ``stkzoo/kernel/kart_observer.c`` computes the
entries, also those that agents observe. Positions are in the frame of the observing kart: x right,
y up, z forward [m].
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.engine.snapshot import CONTROLS, Snapshot
from stkzoo.engine.track import TrackMap
from stkzoo.kernel import KartObserver
from stkzoo.mdp.spaces import kart_observation_space

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]
Batch = dict[str, Any]

_full_space = functools.cache(kart_observation_space)


def observe_karts(
    track: TrackMap,
    kart_types: Sequence[str],
    snapshot: Snapshot,
    karts: IntArray,
    max_paths: int | None = None,
) -> Batch:
    """Returns the observations of some karts in the ``full`` view, in batch form.

    Args:
        track: map of the track.
        kart_types: model of each kart, in grid order.
        snapshot: current snapshot.
        karts: ``(A,)`` indices of the observing karts.
        max_paths: number of track segments ahead; ``None`` for all.
    """
    num_paths = track.num_nodes if max_paths is None else min(max_paths, track.num_nodes)
    sizes = {"items": len(snapshot.items), "karts": len(snapshot.karts) - 1, "paths": num_paths}
    space = _full_space().spaces
    batch = {key: _rows(len(karts), part, key, sizes) for key, part in space.items()}
    observer = KartObserver(tuple(batch), sizes["items"], sizes["karts"], sizes["paths"])
    rows, models = np.arange(len(karts)), tuple(kart_types)
    observer.observe_into(track.graph, num_paths, models, snapshot.data, karts, rows, batch)
    return {**batch, "kart_type": np.array(batch["kart_type"])}


def as_actions(controls: FloatArray) -> Batch:
    """Converts controls ``(..., 7)`` to actions: floats ``(..., 1)`` and buttons ``(...)``."""
    buttons = {name: controls[..., CONTROLS.index(name)].astype(np.int64) for name in CONTROLS[2:]}
    return {"acceleration": controls[..., 0:1], "steer": controls[..., 1:2], **buttons}


def _rows(count: int, space: spaces.Space[Any], key: str, sizes: Mapping[str, int]) -> Any:
    """Returns an entry's uninitialized rows; a list if it is text."""
    if isinstance(space, spaces.Text):
        return [""] * count
    if isinstance(space, spaces.Sequence):
        group = key.partition("_")[0]
        entry = space.feature_space
        return np.empty((count, sizes[group], *(entry.shape or ())), entry.dtype)
    return np.empty((count, *(space.shape or ())), space.dtype)
