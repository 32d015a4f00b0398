"""The twin of ``step_scorer.c``."""

from __future__ import annotations

import operator
from functools import reduce
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.mdp.rewards import KERNEL_TERMS
from stkzoo.mdp.transition import Transition

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]


class StepScorer:
    """Rewards, ends and infos of some agents of a race.

    Args:
        agents: their ids.
        karts: their karts.
        rows: their rows of ``last`` and ``sums``.
        last: ``(R, C)`` the latest step's reward terms and events, which :meth:`score` writes.
        sums: ``(R, C)`` the episode's, to which it adds them.
        keys: of an info, in order.
        race_length: laps times the lap's length [m].
        rewards: for agents that share a reward: numbers of terms in
            :data:`stkzoo.mdp.rewards.KERNEL_TERMS`, their weights, their columns, and the
            agents' places among ``agents``. Other terms are in ``last`` already.
        events: ``(K, E)`` the step's, of all karts: the last columns of ``last``.
    """

    def __init__(
        self,
        agents: tuple[str, ...],
        karts: IntArray,
        rows: IntArray,
        last: FloatArray,
        sums: FloatArray,
        keys: tuple[str, ...],
        race_length: float,
        rewards: tuple[tuple[IntArray, FloatArray, IntArray, IntArray], ...],
        events: FloatArray,
    ) -> None:
        if not len(agents) == len(karts) == len(rows) or last.shape != sums.shape:
            raise ValueError("the arrays do not fit together")
        num_terms = last.shape[1] - events.shape[1]
        is_out = num_terms < 0 or bool((karts >= len(events)).any())
        if is_out or len(keys) != 6 + 2 * last.shape[1]:
            raise ValueError("the arrays do not fit together")
        self._agents, self._karts, self._rows = agents, karts, rows
        self._last, self._sums, self._keys = last, sums, keys
        self._race_length, self._rewards = race_length, rewards
        self._events, self._num_terms = events, num_terms
        self._absent = np.ones(len(last), np.bool_)
        self._absent[rows] = False

    def score(
        self, before: bytes, after: bytes, is_over: bool
    ) -> tuple[dict[str, float], dict[str, bool], dict[str, bool]]:
        """Rewards, terminations and truncations of the step between two moments.

        Args:
            before: the bytes of a snapshot.
            after: the bytes of the next one.
            is_over: whether time is up.
        """
        step = Transition(Snapshot(before), Snapshot(after), self._race_length)
        for terms, weights, columns, who in self._rewards:
            rows, karts = self._rows[who], self._karts[who]
            for term, weight, column in zip(terms, weights, columns, strict=True):
                values = np.asarray(KERNEL_TERMS[term](step), np.float64)
                self._last[rows, column] = weight * values[karts]
        self._last[self._rows, self._num_terms :] = self._events[self._karts]
        self._last[self._absent] = 0.0
        self._sums += self._last
        totals = self._last[:, : self._num_terms].sum(axis=1)[self._rows].tolist()
        finished = (step.after.karts["has_finished_race"][self._karts] > 0).tolist()
        cut_short = [bool(is_over) and not ended for ended in finished]
        rewards, terminations, truncations = (
            dict(zip(self._agents, values, strict=True)) for values in (totals, finished, cut_short)
        )
        return rewards, terminations, truncations

    def infos(self, data: bytes, length: int) -> dict[str, dict[str, Any]]:
        """The infos at a moment, after so many steps."""
        karts = Snapshot(data).karts
        infos = {}
        for agent, row, number in zip(self._agents, self._rows, self._karts, strict=True):
            kart, sums = karts[number], self._sums[row].tolist()
            values = [
                int(kart["position"]),
                max(float(kart["overall_distance"]), 0.0),
                max(int(kart["finished_laps"]), 0),
                float(kart["finish_time"]),
                *self._last[row].tolist(),
                *sums,
                reduce(operator.add, sums[: self._num_terms], 0.0),
                length,
            ]
            infos[agent] = dict(zip(self._keys, values, strict=True))
        return infos
