"""The NumPy reference implementation of ``kart_observer.c``."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.mdp.spaces import EXTRAS, kart_observation_space
from tests.oracle.observations import ai_actions, karts_motion, observe_karts, to_polar
from tests.oracle.track_graph import TrackGraph

IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]
Batch = dict[str, Any]

_KNOWN = {
    *kart_observation_space(use_ai=True, extras=EXTRAS),
    *("items_mask", "karts_mask", "paths_mask"),
}
_POLAR = ("center_path", "items_position", "karts_position", "paths_start", "paths_end")


class KartObserver:
    """Makes the observations of one view.

    Args:
        names: entries of the observation, in order.
        items: number of items in the observation; -1 for all items of the race.
        karts: number of other karts in the observation; -1 for all.
        paths: number of track segments in the observation; -1 for all visible ones.
        polar: whether positions are two angles and a distance.
        flat: whether all numbers form one vector and all choices another one.
        joined: number of values of each choice. If given, the choices are one-hot encoded and
            appended to the vector of numbers.
        nitro: which actions press the nitro button. If given, observations have a mask of the
            actions that have an effect.
        fire: which actions fire.

    Raises:
        ValueError: the arguments do not fit together.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        items: int = -1,
        karts: int = -1,
        paths: int = -1,
        polar: bool = False,
        flat: bool = False,
        joined: IntArray | None = None,
        nitro: BoolArray | None = None,
        fire: BoolArray | None = None,
    ) -> None:
        for name in names:
            if name not in _KNOWN or (flat and name == "action"):
                raise ValueError(f"there is no entry named {name}")
        if flat and min(items, karts, paths) < 0:
            raise ValueError("a flat view must have a fixed size")
        if not flat and (joined is not None or nitro is not None):
            raise ValueError("only a flat view is joined or has a mask")
        self._names, self._is_polar, self._is_flat = names, polar, flat
        self._sizes = {"items": items, "karts": karts, "paths": paths}
        self._joined, self._nitro, self._fire = joined, nitro, fire

    def observe(
        self,
        track: TrackGraph,
        num_paths: int,
        kart_types: tuple[str, ...],
        data: bytes,
        who: IntArray,
    ) -> list[Any]:
        """Returns a list with one observation per kart.

        Args:
            track: the race's track.
            num_paths: number of visible segments of the track.
            kart_types: model name of each kart.
            data: bytes of the snapshot.
            who: ``(A,)`` indices of the observing karts.
        """
        made = self._batch(track, num_paths, kart_types, data, who)
        lists = {group for group, size in self._sizes.items() if size < 0}
        return _singles(made, set() if self._is_flat else lists)

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
        """Writes the observations into rows of a batch.

        Args:
            track: see :meth:`observe`.
            num_paths: see :meth:`observe`.
            kart_types: see :meth:`observe`.
            data: see :meth:`observe`.
            who: see :meth:`observe`.
            rows: row of each kart.
            batch: arrays by entry, with a list for names, or one array if the view is one vector.

        Raises:
            ValueError: the view has no fixed size, or the arguments do not fit together.
        """
        if len(who) != len(rows):
            raise ValueError(f"{len(who)} karts for {len(rows)} rows")
        for name in () if self._is_flat else self._names:
            if name == "action" or self._sizes.get(name.partition("_")[0], 0) < 0:
                raise ValueError(f"{name} has no row in a batch")
        made = self._batch(track, num_paths, kart_types, data, who)
        if not isinstance(made, dict):
            batch[rows] = made
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
        if not 0 <= num_paths <= len(track.path_nodes):
            raise ValueError(f"{num_paths} of {len(track.path_nodes)} segments")
        for kart in who.tolist():
            if not 0 <= kart < len(snapshot.karts):
                raise IndexError(f"kart {kart} of {len(snapshot.karts)}")
        batch = observe_karts(track, kart_types, snapshot, who, num_paths)
        if {"karts_velocity", "karts_heading"} & set(self._names):
            batch |= karts_motion(snapshot, who)
        if "action" in self._names:
            batch["action"] = dict(sorted(ai_actions(snapshot, who).items()))
        for group, size in self._sizes.items():
            if size >= 0:
                _resize(batch, group, size)
        if self._is_polar:
            batch.update({key: to_polar(batch[key]) for key in _POLAR})
        own = {name: batch[name] for name in self._names}
        return self._vectors(own, batch) if self._is_flat else own

    def _vectors(self, own: Batch, batch: Batch) -> Any:
        parts = [(np.reshape(part, (len(part), -1)), part.dtype) for part in own.values()]
        choices = np.concatenate([part for part, kind in parts if kind == np.int64], axis=1)
        numbers = [part for part, kind in parts if kind != np.int64]
        continuous = np.concatenate(numbers, axis=1, dtype=np.float32)
        mask = {}
        if self._nitro is not None and self._fire is not None:
            has = batch["energy"], batch["powerup_type"]
            mask["action_mask"] = action_mask(self._nitro, self._fire, *has)
        if self._joined is None:
            return {**mask, "continuous": continuous, "discrete": choices}
        ones = []
        for number, size in enumerate(self._joined.tolist()):
            column = choices[:, number]
            if np.any((column < 0) | (column >= size)):
                raise IndexError(f"choice {number} is out of its range")
            ones.append(np.eye(size, dtype=np.float32)[column])
        vector = np.concatenate([continuous, *ones], axis=1)
        return {**mask, "observation": vector} if mask else vector


def action_mask(
    nitro: BoolArray,
    fire: BoolArray,
    energy: npt.NDArray[np.float32],
    powerup_types: npt.NDArray[np.int64],
) -> npt.NDArray[np.int8]:
    """Returns the masks of A karts, ``(A, n)`` int8: 1 for actions that have an effect."""
    has_nitro, has_powerup = energy.reshape(-1, 1) > 0, powerup_types.reshape(-1, 1) != 0
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


def _singles(batch: Any, lists: set[str]) -> list[Any]:
    """Returns the rows of a batch in Gymnasium's format, with entries of ``lists`` as tuples."""
    if not isinstance(batch, dict):
        return list(batch)
    columns = []
    for key, part in batch.items():
        if isinstance(part, dict):
            columns.append(_singles(part, lists))
        elif part.ndim == 1:
            columns.append(part.tolist())
        elif key.partition("_")[0] in lists:
            columns.append([tuple(row) for row in np.array(part)])
        else:
            columns.append(list(np.array(part)))
    return [dict(zip(batch, row, strict=True)) for row in zip(*columns, strict=True)]
