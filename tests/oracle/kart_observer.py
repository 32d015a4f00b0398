"""The NumPy implementation of ``kart_observer.c``."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from tests.oracle.observations import karts_motion, observe_karts, to_polar
from tests.oracle.track_graph import TrackGraph

IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]
Batch = dict[str, Any]

_POLAR = ("center_path", "items_position", "karts_position", "paths_start", "paths_end")


class KartObserver:
    def __init__(
        self,
        entries: tuple[tuple[str, str, int], ...],
        items: int = -1,
        karts: int = -1,
        paths: int = -1,
        polar: bool = False,
        uses: BoolArray | None = None,
    ) -> None:
        self._entries, self._is_polar, self._uses = entries, polar, uses
        self._sizes = {"items": items, "karts": karts, "paths": paths}

    def observe(
        self,
        track: TrackGraph,
        num_paths: int,
        kart_types: tuple[str, ...],
        data: bytes,
        who: IntArray,
    ) -> list[Any]:
        made = self._batch(track, num_paths, kart_types, data, who)
        return _singles(made, {*self._sizes})

    def observe_into(
        self,
        track: TrackGraph,
        num_paths: int,
        kart_types: tuple[str, ...],
        data: bytes,
        who: IntArray,
        rows: IntArray,
        batch: Any,
    ) -> None:
        made = self._batch(track, num_paths, kart_types, data, who)
        if not isinstance(batch, dict):
            (batch[rows],) = made.values()
            return
        for name, values in made.items():
            if isinstance(batch[name], list):
                for row, value in zip(rows.tolist(), values.tolist(), strict=True):
                    batch[name][row] = value
            else:
                batch[name][rows] = values

    def _batch(
        self,
        track: TrackGraph,
        num_paths: int,
        kart_types: tuple[str, ...],
        data: bytes,
        who: IntArray,
    ) -> Any:
        """Returns the observations of some karts, with a leading axis over karts."""
        snapshot = Snapshot(data)
        batch = observe_karts(track, kart_types, snapshot, who, num_paths)
        if {"karts_velocity", "karts_heading"} & {name for name, *_ in self._entries}:
            batch |= karts_motion(snapshot, who)
        for group, size in self._sizes.items():
            if size >= 0:
                _resize(batch, group, size)
        if self._is_polar:
            batch.update({key: to_polar(batch[key]) for key in _POLAR})
        if self._uses is not None:
            state = (batch[key].reshape(-1, 1) for key in ("energy", "powerup_type"))
            batch["action_mask"] = action_mask(*state, self._uses)
        parts: dict[str, list[Any]] = {}
        for name, part, values in self._entries:
            rows = batch[name]
            if part != name:
                rows = np.eye(values)[rows] if values else rows
                rows = np.reshape(rows, (len(rows), -1))
            parts.setdefault(part, []).append(rows)
        return {part: _joined(rows) for part, rows in parts.items()}


def _joined(rows: list[Any]) -> Any:
    if len(rows) == 1:
        return rows[0]
    kind = np.int64 if all(part.dtype == np.int64 for part in rows) else np.float32
    return np.concatenate(rows, axis=1, dtype=kind)


def action_mask(energy: Any, powerup: Any, uses: BoolArray) -> npt.NDArray[np.int8]:
    nitro, fire = uses
    has_nitro, has_powerup = np.greater(energy, 0), np.not_equal(powerup, 0)
    return np.asarray((~nitro | has_nitro) & (~fire | has_powerup), np.int8)


def _resize(batch: Batch, group: str, size: int) -> None:
    """Cuts or pads a group's entries to a number of rows, and adds their mask."""
    for key in [key for key in batch if key.startswith(f"{group}_")]:
        rows = batch[key]
        length = min(size, rows.shape[1])
        batch[key] = np.zeros((len(rows), size, *rows.shape[2:]), rows.dtype)
        batch[key][:, :length] = rows[:, :length]
        mask = np.zeros((len(rows), size), np.int8)
        mask[:, :length] = 1
        batch[f"{group}_mask"] = mask


def _singles(batch: Batch, lists: set[str]) -> list[Any]:
    """Returns the rows of a batch in Gymnasium's format, with entries of ``lists`` as tuples."""
    columns = []
    for key, part in batch.items():
        if part.ndim == 1:
            columns.append(part.tolist())
        elif key.partition("_")[0] in lists:
            columns.append([tuple(row) for row in np.array(part)])
        else:
            columns.append(list(np.array(part)))
    return [dict(zip(batch, row, strict=True)) for row in zip(*columns, strict=True)]
