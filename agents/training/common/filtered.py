"""The action filter as a view of many karts."""

from __future__ import annotations

import numpy as np

from stkzoo.agents.planning import BoolArray, FloatArray, IntArray
from stkzoo.agents.pretrained.action_filter import ActionFilter
from stkzoo.agents.pretrained.recurrent import GatedUnit
from stkzoo.wrappers.racing import CHOICES, CONTEST_MIRROR


class FilteredView:
    """What karts in the view ``racing`` or ``contest`` see and do through an :class:`ActionFilter`.

    Observations get :data:`~stkzoo.agents.planning.memory.MEMORY_SIZE` more columns. The methods
    are those of :class:`~stkzoo.agents.planning.mirrored.MemoryView`.

    Args:
        count: number of karts.
        hold: minimum steps of a drift.
        size: size of the memory of a recurrent policy; 0 without one.
    """

    def __init__(self, count: int, hold: int, size: int = 0) -> None:
        self._filter = ActionFilter(count, hold)
        self._filter.recurrent = np.zeros((count, size), np.float32)
        self._is_mirrored = np.zeros(count, np.bool_)

    def take_unit(self, unit: GatedUnit) -> None:
        """Changes the unit that computes the memory of a recurrent policy."""
        self._filter.unit = unit

    def begin(self, rows: IntArray, is_mirrored: BoolArray) -> None:
        """Empties the memory of some karts, whose race begins."""
        self._filter.forget(rows)
        self._is_mirrored[rows] = is_mirrored

    def observe(self, seen: FloatArray, *, advances: bool = True) -> FloatArray:
        """Returns the inputs of a policy, ``(karts, F + 12 + size)``."""
        views = np.where(self._is_mirrored[:, None], seen * CONTEST_MIRROR[: seen.shape[1]], seen)
        return (self._filter.look if advances else self._filter.see)(views)

    def drive(self, choices: IntArray) -> IntArray:
        """Returns filtered choices ``(karts, 5)``."""
        done = self._filter.apply(choices)
        done[self._is_mirrored, 0] = CHOICES[0] - 1 - done[self._is_mirrored, 0]
        return done
