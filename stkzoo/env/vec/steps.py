"""The results of one step of all slots.

Observations and infos have two forms. If the kernel runs all wrappers of all agents, it writes rows
of arrays (:class:`RowObservations`, :class:`InfoTables`). Otherwise they are values of single
agents, which are stacked (:class:`StackedObservations`, :class:`InfoDicts`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector.utils import concatenate, create_empty_array

from stkzoo.env.episode import WHOLE_INFOS

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.intp]


@dataclass(slots=True)
class SlotSteps:
    """One step of ``S`` slots.

    Attributes:
        observations: next observation of each slot: after the end of a race, the first observation
            of the next one; for an idle slot, zeros. A list while the step is collected by agent,
            afterwards a batch.
        infos: info of each slot, for the same moment as its observation; empty for idle slots.
        rewards: ``(S,)`` float64, 0 for idle slots.
        terminations: ``(S,)`` bool, whether the slot's agent finished in this step.
        truncations: ``(S,)`` bool, whether the slot's agent was truncated in this step.
        active: ``(S,)`` bool, whether the slot's agent acted in this step.
        crashed: ``(S,)`` bool, whether the slot's game crashed in this step.
        tracks: ``(S,)`` number of each slot's track, for the same moment as its observation.
        finals: last observation and info of the slots that ended in this step, by slot.
    """

    observations: Any
    infos: InfoTables | InfoDicts
    rewards: npt.NDArray[np.float64]
    terminations: BoolArray
    truncations: BoolArray
    active: BoolArray
    crashed: BoolArray
    tracks: npt.NDArray[np.int64]
    finals: dict[int, tuple[Any, dict[str, Any]]] = field(default_factory=dict)

    @classmethod
    def idle(cls, observations: Any, infos: InfoTables | InfoDicts, count: int) -> SlotSteps:
        """Returns a step in which all slots are idle."""
        terminations, truncations, active, crashed = np.zeros((4, count), np.bool_)
        return cls(
            observations=observations,
            infos=infos,
            rewards=np.zeros(count),
            terminations=terminations,
            truncations=truncations,
            active=active,
            crashed=crashed,
            tracks=np.zeros(count, np.int64),
        )


class RowObservations:
    """Batches of observations whose rows the kernel writes.

    Args:
        space: observation space of one slot, a ``Dict`` or a space of arrays.
        idle: observation of an idle slot.
        count: number of slots.
    """

    def __init__(self, space: spaces.Space[Any], idle: Any, count: int) -> None:
        parts = space.spaces if isinstance(space, spaces.Dict) else {"": space}
        self._is_dict = isinstance(space, spaces.Dict)
        self._idle = idle if self._is_dict else {"": idle}
        self._count = count
        self._arrays = {
            key: ((count, *(part.shape or ())), part.dtype)
            for key, part in parts.items()
            if not isinstance(part, spaces.Text)
        }
        self._keys = tuple(parts)

    def new(self) -> Any:
        """Returns a batch without content: arrays, and lists for texts."""
        if not self._is_dict:
            return np.empty(*self._arrays[""])
        return {
            key: np.empty(*self._arrays[key]) if key in self._arrays else [""] * self._count
            for key in self._keys
        }

    def finish(self, batch: Any, idle: IntArray) -> Any:
        """Writes the rows of idle slots, which completes a batch, and returns it.

        Args:
            batch: batch from :meth:`new`.
            idle: numbers of the idle slots.
        """
        parts = batch if self._is_dict else {"": batch}
        for key in self._keys if len(idle) else ():
            if key in self._arrays:
                parts[key][idle] = self._idle[key]
            else:
                for slot in idle.tolist():
                    parts[key][slot] = self._idle[key]
        for key in self._keys:
            if key not in self._arrays:
                parts[key] = tuple(parts[key])  # as Gymnasium stacks texts
        return batch


class StackedObservations:
    """Batches that are stacked from single observations.

    Args:
        space: observation space of one slot.
        idle: observation of an idle slot.
        count: number of slots.
    """

    def __init__(self, space: spaces.Space[Any], idle: Any, count: int) -> None:
        self._space, self._idle, self._count = space, idle, count

    def new(self) -> list[Any]:
        """Returns a list of idle observations, one per slot."""
        return [self._idle] * self._count

    def finish(self, observations: list[Any], _: IntArray) -> Any:
        """Stacks the observations into a new array or dict of arrays."""
        empty: Any = create_empty_array(self._space, self._count)
        return concatenate(self._space, observations, empty)


@dataclass(frozen=True, slots=True)
class InfoTable:
    """Infos with the same keys.

    Attributes:
        rows: row of each key in ``values``.
        values: ``(K, S)`` float64.
        has: ``(S,)`` bool, slots with these keys.
    """

    rows: dict[str, int]
    values: npt.NDArray[np.float64]
    has: BoolArray


class InfoTables:
    """Infos of all slots as arrays: one table, or several if races have different keys.

    Args:
        count: number of slots.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._tables: dict[tuple[str, ...], InfoTable] = {}

    def of(self, keys: tuple[str, ...]) -> InfoTable:
        """Returns the table with some keys, in order."""
        if keys not in self._tables:
            values = np.zeros((len(keys), self._count))
            rows = {key: row for row, key in enumerate(keys)}
            self._tables[keys] = InfoTable(rows, values, np.zeros(self._count, np.bool_))
        return self._tables[keys]

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Returns an array of values and a mask for each key, in Gymnasium's form."""
        columns: dict[str, npt.NDArray[Any]] = {}
        for table in self._tables.values():
            masks = np.tile(table.has, (len(table.rows), 1))
            for (key, row), mask in zip(table.rows.items(), masks, strict=True):
                values = table.values[row]
                values = values.astype(np.int64) if key in WHOLE_INFOS else values
                if key in columns:  # other slots have it in another table, and 0 in this one
                    values, mask = values + columns[key], mask | columns[f"_{key}"]
                columns[key], columns[f"_{key}"] = values, mask
        return columns

    def keys_of(self, slot: int) -> Collection[str]:
        """Returns the keys of a slot's info; none if it is idle."""
        table = self._table_of(slot)
        return () if table is None else table.rows

    def value(self, slot: int, key: str) -> Any:
        """Returns one value of a slot's info; raises ``KeyError`` if there is none."""
        table = self._table_of(slot)
        if table is None:
            raise KeyError(key)
        value = float(table.values[table.rows[key], slot])
        return int(value) if key in WHOLE_INFOS else value

    def _table_of(self, slot: int) -> InfoTable | None:
        for table in self._tables.values():
            if table.has[slot]:
                return table
        return None


class InfoDicts:
    """Infos of all slots as dicts.

    Args:
        count: number of slots.
        add: Gymnasium's ``VectorEnv._add_info``, which adds the info of a slot to its form.
    """

    def __init__(
        self, count: int, add: Callable[[dict[str, Any], dict[str, Any], int], dict[str, Any]]
    ) -> None:
        self._dicts: list[dict[str, Any]] = [{} for _ in range(count)]
        self._add = add

    def set(self, slot: int, info: dict[str, Any]) -> None:
        """Sets the info of a slot."""
        self._dicts[slot] = info

    def columns(self) -> dict[str, Any]:
        """Returns the infos in Gymnasium's form; faster than ``add`` if all have the same keys."""
        slots = [slot for slot, info in enumerate(self._dicts) if info]
        infos = [self._dicts[slot] for slot in slots]
        keys = list(infos[0]) if infos else []
        is_table = bool(infos) and all(list(info) == keys for info in infos)
        table = _table([list(info.values()) for info in infos] if is_table else [])
        kinds = [np.asarray(value).dtype for value in infos[0].values()] if is_table else []
        columns: dict[str, Any] = {}
        if table.ndim != 2 or table.dtype.kind not in "biuf" or _loses_digits(table, kinds):
            for slot, info in zip(slots, infos, strict=True):
                columns = self._add(columns, dict(info), slot)
            return columns
        numbers = np.zeros((len(keys), len(self._dicts)), table.dtype)
        masks = np.zeros(numbers.shape, np.bool_)
        numbers[:, slots], masks[:, slots] = table.T, True
        for key, kind, row, mask in zip(keys, kinds, numbers, masks, strict=True):
            columns[key] = row.astype(kind, copy=False)
            columns[f"_{key}"] = mask
        return columns

    def keys_of(self, slot: int) -> Collection[str]:
        """Returns the keys of a slot's info; none if it is idle."""
        return self._dicts[slot]

    def value(self, slot: int, key: str) -> Any:
        """Returns one value of a slot's info; raises ``KeyError`` if there is none."""
        return self._dicts[slot][key]


def _table(rows: Sequence[Sequence[Any]]) -> npt.NDArray[Any]:
    """Returns the values of infos as one array; an empty one if some are arrays or lists."""
    try:
        return np.array(rows)
    except ValueError:
        return np.array([])


def _loses_digits(table: npt.NDArray[Any], kinds: Sequence[np.dtype[Any]]) -> bool:
    """Returns whether whole numbers of some columns are too large for the floats of a table."""
    if table.dtype.kind != "f":
        return False
    whole = [number for number, kind in enumerate(kinds) if kind.kind in "iu"]
    return bool((np.abs(table[:, whole]) >= 2.0**53).any())
