"""The NumPy reference implementation of ``action_reader.c``."""

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
    """Converts actions of one space to controls.

    Args:
        names: keys of an action; empty if an action is one array or number.
        leaves: for each key, a tuple per number: its lowest value, its highest value, whether it is
            a whole number, its column in the controls, and a table or ``None``. A table belongs to
            a choice and has a row for each value; that row is added to the controls from the column
            on.
        num_columns: number of columns of the controls.

    Raises:
        ValueError: the leaves do not fit together.
    """

    def __init__(
        self, names: tuple[str, ...], leaves: tuple[tuple[Entry, ...], ...], num_columns: int
    ) -> None:
        if len(leaves) != (len(names) or 1):
            raise ValueError("expected one leaf per name, or one leaf without a name")
        self._names = names
        self._leaves = tuple(
            tuple(_checked(entry, num_columns) for entry in leaf) for leaf in leaves
        )

    def read(
        self,
        actions: Any,
        agents: tuple[str, ...],
        rows: npt.NDArray[np.intp],
        controls: npt.NDArray[np.float32],
    ) -> bool:
        """Reads the action of each agent into its row of the controls.

        Returns:
            Whether every agent has an action that is in its space and in a usual form.
        """
        if len(agents) != len(rows):
            raise ValueError(f"{len(agents)} agents for {len(rows)} rows")
        return isinstance(actions, dict) and all(
            self._read_action(actions.get(agent), controls[row])
            for agent, row in zip(agents, rows.tolist(), strict=True)
        )

    def read_batch(
        self,
        batch: Any,
        count: int,
        slots: npt.NDArray[np.intp],
        rows: npt.NDArray[np.intp],
        controls: npt.NDArray[np.float32],
    ) -> bool:
        """Reads the actions of some slots into rows of the controls.

        Args:
            batch: an array with a row for each slot, or a dict of such arrays.
            count: number of slots.
            slots: slot of each action to read.
            rows: row of each action in ``controls``.
            controls: ``(P, C)`` float32, whose rows are overwritten.

        Returns:
            Whether all actions are in their space and in a usual form.
        """
        if len(slots) != len(rows):
            raise ValueError(f"{len(slots)} slots for {len(rows)} rows")
        columns = batch if self._names else {"": batch}
        names = self._names or ("",)
        if not isinstance(columns, dict) or columns.keys() != {*names}:
            return False
        if not all(
            _is_column(leaf, columns[name], count)
            for name, leaf in zip(names, self._leaves, strict=True)
        ):
            return False
        for slot, row in zip(slots.tolist(), rows.tolist(), strict=True):
            action = {name: columns[name][slot] for name in names}
            if not self._read_action(action if self._names else action[""], controls[row]):
                return False
        return True

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


def _checked(entry: Entry, num_columns: int) -> Entry:
    low, high, is_whole, column, table = entry
    width = 1
    if table is not None:
        steps = int(high - low) + 1
        width = table.size // steps
        if not is_whole or table.size == 0 or table.size % steps:
            raise ValueError("a table must have a row for each whole number")
        table = table.reshape(steps, width)
    if not 0 <= column <= num_columns - width:
        raise ValueError("an entry has a column beyond the last one")
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
