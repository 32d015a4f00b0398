"""The NumPy implementation of ``action_reader.c``."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

#: One number of an action: (low, high, is whole, column, table or ``None``).
Entry = tuple[float, float, bool, int, Any]

#: :data:`stkzoo.views.actions.BOUND_TOLERANCE`
_TOLERANCE = 1e-6
_SCALARS = (bool, int, float, np.bool_, np.integer, np.floating)


class ActionReader:
    def __init__(self, names: tuple[str, ...], leaves: tuple[tuple[Entry, ...], ...]) -> None:
        self._names = names
        self._leaves = tuple(tuple(map(_with_rows, leaf)) for leaf in leaves)

    def read(
        self,
        actions: Any,
        who: Any,
        rows: npt.NDArray[np.intp],
        controls: npt.NDArray[np.float32],
        count: int = -1,
    ) -> bool:
        if count >= 0:
            chosen = self._actions_of_slots(actions, count, who)
        else:
            chosen = [actions.get(agent) for agent in who] if isinstance(actions, dict) else None
        return chosen is not None and all(
            self._read_action(action, controls[row])
            for action, row in zip(chosen, rows.tolist(), strict=True)
        )

    def _actions_of_slots(
        self, batch: Any, count: int, slots: npt.NDArray[np.intp]
    ) -> list[Any] | None:
        """Returns the actions of some slots; ``None`` if the batch has another form."""
        columns = batch if self._names else {"": batch}
        names = self._names or ("",)
        if not isinstance(columns, dict) or columns.keys() != {*names}:
            return None
        if not all(
            _is_column(leaf, columns[name], count)
            for name, leaf in zip(names, self._leaves, strict=True)
        ):
            return None
        actions = ({name: columns[name][slot] for name in names} for slot in slots.tolist())
        return [action if self._names else action[""] for action in actions]

    def _read_action(self, action: Any, row: npt.NDArray[np.float32]) -> bool:
        row[:] = 0.0
        if not self._names:
            return _read_leaf(self._leaves[0], action, row)
        if not isinstance(action, dict) or len(action) != len(self._names):
            return False
        return all(
            name in action and _read_leaf(leaf, action[name], row)
            for name, leaf in zip(self._names, self._leaves, strict=True)
        )


def _with_rows(entry: Entry) -> Entry:
    """Returns the entry with a table that has a row for each value."""
    low, high, is_whole, column, table = entry
    if table is not None:
        table = table.reshape(int(high - low) + 1, -1)
    return low, high, is_whole, column, table


def _is_column(leaf: tuple[Entry, ...], value: Any, count: int) -> bool:
    """Returns whether a value is an array with a row of the leaf's numbers for each slot."""
    if not isinstance(value, np.ndarray) or value.ndim == 0 or len(value) != count:
        return False
    return value.size == count * len(leaf) and (value.ndim == 2 or len(leaf) == 1)


def _read_leaf(leaf: tuple[Entry, ...], value: Any, row: npt.NDArray[np.float32]) -> bool:
    if isinstance(value, np.ndarray):
        is_usual = value.dtype.kind in "bif" and (value.ndim == 1 or len(leaf) == 1)
        if not is_usual or value.size != len(leaf):
            return False
        numbers = value.reshape(-1).tolist()
    elif len(leaf) == 1 and isinstance(value, _SCALARS):
        numbers = [value]
    else:
        return False
    return all(_put(entry, number, row) for entry, number in zip(leaf, numbers, strict=True))


def _put(entry: Entry, value: Any, row: npt.NDArray[np.float32]) -> bool:
    low, high, is_whole, column, table = entry
    slack = 0.0 if is_whole else _TOLERANCE
    if not low - slack <= value <= high + slack or (is_whole and value != int(value)):
        return False
    if table is None:
        row[column] = min(max(value, low), high)
    else:
        row[column : column + table.shape[1]] += table[int(value - low)]
    return True
