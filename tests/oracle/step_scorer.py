"""The NumPy implementation of ``step_scorer.c``."""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import reduce

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.mdp.transition import Transition

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]


def progress(step: Transition) -> FloatArray:
    """Returns 0.1 per meter driven, ``(K,)``."""
    return np.asarray((step.distance - step.distance_before) / 10.0, np.float64)


def rank(step: Transition) -> FloatArray:
    """Returns (1 - position/K) (3 + 7 f), where f is 1 in the finishing step and otherwise 0."""
    return (1.0 - step.after.karts["position"] / step.num_kart) * (3.0 + 7.0 * step.finishes)


def time(step: Transition) -> FloatArray:
    """Returns -0.1 in every step, a time penalty."""
    return np.full(step.num_kart, -0.1)


def finish(step: Transition) -> FloatArray:
    """Returns 10 in the finishing step and otherwise 0."""
    return np.where(step.finishes, 10.0, 0.0)


def course(step: Transition) -> FloatArray:
    """Returns the fraction of the race driven in this step, ``(K,)``; a finisher's sum is 1."""
    done = _driven(step.after, step.distance, step.race_length)
    return (done - np.minimum(step.distance_before, step.race_length)) / step.race_length


def _driven(moment: Snapshot, distance: FloatArray, race_length: float) -> FloatArray:
    """Returns the distance driven [m], ``(K,)``, limited to the length of the race."""
    # The engine may finish a kart a few centimeters before the line.
    has_finished = moment.karts["has_finished_race"] > 0
    return np.where(has_finished, race_length, np.minimum(distance, race_length))


def placement(step: Transition) -> FloatArray:
    """In the finishing step, returns 1 for the winner down to 0 for the last, evenly spaced."""
    others = max(step.num_kart - 1, 1)
    return step.finishes * (step.num_kart - step.after.karts["position"]) / others


def advance(step: Transition) -> FloatArray:
    """Returns 0.1 per meter driven up to the finish line, ``(K,)``."""
    return (
        _driven(step.after, step.distance, step.race_length)
        - _driven(step.before, step.distance_before, step.race_length)
    ) / 10.0


def place(step: Transition) -> FloatArray:
    """Returns the change of 20 (K - position)/(K - 1) times the fraction of the race driven.

    The term is potential-based: over a whole race it sums to 20 for the winner and 0 for the last
    kart, from every place on the grid. Early in the race a place counts little, because the driven
    fraction is small.
    """

    def potential(moment: Snapshot, distance: FloatArray) -> FloatArray:
        share = _driven(moment, distance, step.race_length) / step.race_length
        ahead_of = (step.num_kart - moment.karts["position"]) / max(step.num_kart - 1, 1)
        return np.asarray(20.0 * ahead_of * share, np.float64)

    return potential(step.after, step.distance) - potential(step.before, step.distance_before)


def overtaking(step: Transition) -> FloatArray:
    """1 for each place gained, -1 for each place lost."""
    return step.before.karts["position"] - step.after.karts["position"].astype(np.float64)


#: The built-in terms by name.
TERMS: dict[str, Callable[[Transition], FloatArray]] = {
    term.__name__: term
    for term in (progress, rank, time, finish, course, placement, advance, place, overtaking)
}


class StepScorer:
    def __init__(
        self,
        karts: IntArray,
        last: FloatArray,
        sums: FloatArray,
        owed: FloatArray,
        limits: FloatArray,
        race_length: float,
        rewards: tuple[tuple[tuple[str, ...], FloatArray, IntArray], ...],
        events: FloatArray,
    ) -> None:
        self._karts, self._last, self._sums = karts, last, sums
        self._race_length, self._rewards = race_length, rewards
        self._owed, self._limits = owed, limits
        self._events, self._num_terms = events, limits.shape[1]

    def score_into(
        self,
        before: bytes,
        after: bytes,
        is_over: bool,
        who: IntArray,
        slots: IntArray,
        rewards: FloatArray,
        terminations: BoolArray,
        truncations: BoolArray,
    ) -> None:
        step = Transition(Snapshot(before), Snapshot(after), self._race_length)
        for agent in who:
            for term, weight, column in zip(*self._rewards[agent], strict=True):
                values = np.asarray(TERMS[term](step), np.float64)
                self._last[agent, column] = weight * values[self._karts[agent]]
            owed, limits = self._owed[agent], self._limits[agent]
            earned = self._last[agent, : self._num_terms]
            paid, left = earned.clip(-limits, limits), owed + earned
            paid += owed.clip(-limits / 10, limits / 10)
            if step.after.karts["has_finished_race"][self._karts[agent]] > 0:
                paid = left
            earned[:], owed[:] = paid, np.where(np.isinf(limits), 0.0, left - paid)
        if self._events.size:
            self._last[who, self._num_terms :] = self._events[self._karts[who]]
        self._last[np.setdiff1d(np.arange(len(self._karts)), who)] = 0.0
        self._sums += self._last
        rewards[slots] = self._last[who, : self._num_terms].sum(axis=1)
        terminations[slots] = step.after.karts["has_finished_race"][self._karts[who]] > 0
        truncations[slots] = terminations[slots] < bool(is_over)

    def infos_into(
        self,
        data: bytes,
        length: int,
        who: IntArray,
        slots: IntArray,
        wholes: npt.NDArray[np.int64],
        numbers: FloatArray,
    ) -> None:
        karts = Snapshot(data).karts
        for slot, agent in zip(slots, who, strict=True):
            kart, sums = karts[self._karts[agent]], self._sums[agent].tolist()
            wholes[:, slot] = kart["position"], max(int(kart["finished_laps"]), 0), length
            total = reduce(operator.add, sums[: self._num_terms], 0.0)
            driven = max(float(kart["overall_distance"]), 0.0)
            own = driven, kart["finish_time"], *self._last[agent].tolist(), *sums, total
            numbers[:, slot] = own
