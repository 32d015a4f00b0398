"""A stateful filter between a policy's choices and the kart."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning import BoolArray, FloatArray, IntArray
from stkzoo.agents.planning.driver import START_STEER, steer_of_turn
from stkzoo.agents.planning.memory import MEMORY_MIRROR, MEMORY_SIZE, DriverMemory
from stkzoo.agents.planning.motion import DRIFT_TURN
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.wrappers.racing import BRAKE, CHOICES, MIRROR, PLACES, RESCUE, SIZE, STEERS

from .recurrent import GatedUnit

#: Size of a policy's input with the filter: the view, and the filter's memory.
INPUT_SIZE = SIZE + MEMORY_SIZE
#: Multiplying an input by this mirrors it left to right.
INPUT_MIRROR = np.concatenate([MIRROR, MEMORY_MIRROR])

#: Columns of the choices.
_STEER, _PEDAL, _DRIFT, _NITRO, _FIRE = range(5)
#: Indices in the view of the forward speed [20 m/s] and of the first value of other parts.
_SPEED = PLACES["velocity"].start + 2
_SKEED, _ENERGY, _LINE, _ROOM, _HEADING = (
    PLACES[part].start
    for part in ("skeed_factor", "energy", "line_position", "line_room", "marks_heading")
)
#: Minimum speed of a drift [20 m/s], and steering to the other side that ends it. A drift begins
#: to the side to which the kart steers.
_DRIFT_SPEED, _OTHER_SIDE = 10.0 / 20.0, 0.3
#: Boundaries between the steering choices.
_BETWEEN = (STEERS[1:] + STEERS[:-1]) / 2
#: A kart that has reached this speed has left the grid [20 m/s].
_MOVES = 3.0 / 20.0


class ActionFilter:
    """Modifies a policy's choices with a memory that the policy also observes.

    - **Drifts last.** A drift earns a boost after one second. A policy that decides randomly in
      each step whether to continue rarely drifts that long, so the filter holds a drift for a
      minimum time. The game maps steering differently in a drift; the filter compensates, so that a
      choice turns the kart as much as without a drift, within the limits of a drift. Steering to
      the other side ends the drift.
    - **Nitro is not wasted.** A burst ends before the next one begins.
    - **Stuck karts free themselves**, as with the planner.

    Args:
        karts: number of karts.
        hold: minimum steps of a drift; 0 leaves drifts and nitro to the choices.
        memory: the karts' memory; by default, a new one.
        recovers: whether stuck karts free themselves.
        samples: whether :meth:`drive` samples choices from their probabilities. The seed is the
            kart's first observation, so a race can be repeated.
        unit: see :attr:`unit`.

    Attributes:
        unit: computes the memory of a recurrent policy; ``None`` without one.
        recurrent: this memory, ``(karts, H)``; 0 until a kart has left the grid.
    """

    def __init__(
        self,
        karts: int,
        hold: int,
        memory: DriverMemory | None = None,
        *,
        recovers: bool = True,
        samples: bool = False,
        unit: GatedUnit | None = None,
    ) -> None:
        self.unit = unit
        self.recurrent = np.zeros((karts, unit.size if unit else 0), np.float32)
        self._hold, self._recovers, self._samples = hold, recovers, samples
        self._random: np.random.Generator | None = None
        self._memory = memory or DriverMemory(karts, DriverParameters())
        self._has_moved = np.zeros(karts, np.bool_)
        self._views = np.zeros((karts, SIZE), np.float32)

    def drive(self, observation: FloatArray, choose: Callable[..., IntArray]) -> IntArray:
        """Returns the choices ``(5,)`` of one kart; call it once per step.

        Args:
            observation: observation in the view ``racing`` or ``contest``.
            choose: returns a policy's choices ``(1, 5)`` for its input and, if the filter samples,
                the noise that is added to the logits.
        """
        return self.drive_together([self], [observation], choose)[0]

    @staticmethod
    def drive_together(
        filters: Sequence[ActionFilter],
        observations: Sequence[FloatArray],
        choose: Callable[..., IntArray],
    ) -> list[IntArray]:
        """Returns the same choices as :meth:`drive` for each filter, bit for bit, in less time.

        Args:
            filters: filters of one kart each, with equal ``hold``.
            observations: their observations.
            choose: returns a policy's choices ``(A, 5)``; each row must depend only on its own
                kart.
        """
        joined = filters[0] if len(filters) == 1 else ActionFilter._joined(filters)
        pairs = zip(filters, observations, strict=True)
        noise = [single._noise(seen) for single, seen in pairs if single._samples]
        inputs = joined.look(np.stack(observations))
        done = joined.apply(choose(inputs, np.stack(noise)) if noise else choose(inputs))
        if len(filters) > 1:
            for row, single in enumerate(filters):
                single._memory.take(joined._memory, slice(row, row + 1))
                single._has_moved = joined._has_moved[row : row + 1]
                single.recurrent = joined.recurrent[row : row + 1]
        return list(done)

    @classmethod
    def _joined(cls, filters: Sequence[ActionFilter]) -> ActionFilter:
        memory = DriverMemory.joined([single._memory for single in filters])
        first = filters[0]
        joined = cls(0, first._hold, memory, recovers=first._recovers, unit=first.unit)
        joined._has_moved = np.concatenate([single._has_moved for single in filters])
        joined.recurrent = np.concatenate([single.recurrent for single in filters])
        return joined

    def _noise(self, observation: FloatArray) -> FloatArray:
        """Returns Gumbel noise for the logits of one kart's choices."""
        if self._random is None:
            self._random = np.random.default_rng(zlib.crc32(observation.tobytes()))
        return self._random.gumbel(size=sum(CHOICES)).astype(np.float32)

    def look(self, views: FloatArray) -> FloatArray:
        """Advances the memory by one step.

        Args:
            views: ``(karts, F)`` observations in the view ``racing`` or ``contest``.

        Returns:
            Input of the policy, ``(karts, F + 12 + H)``: the views, the memory, and that of a
                recurrent policy.
        """
        self._memory.look(20.0 * views[:, _SPEED], views[:, _SKEED])
        aside = np.hypot(views[:, _LINE], views[:, _LINE + 2]) - views[:, _ROOM]
        self._memory.look_around(10.0 * aside)
        self._has_moved |= np.abs(views[:, _SPEED]) > _MOVES
        self._memory.forget(np.flatnonzero(~self._has_moved))  # karts on the grid are not stuck
        if self.unit:
            seen = np.concatenate([views, self._memory.numbers()], axis=1)
            self.recurrent = self.unit(seen, self.recurrent) * self._has_moved[:, None]
        return self.see(views)

    def see(self, views: FloatArray) -> FloatArray:
        """Returns the policy's input without advancing the memory."""
        self._views = views
        return np.concatenate([views, self._memory.numbers(), self.recurrent], axis=1)

    def apply(self, choices: npt.NDArray[Any]) -> IntArray:
        """Returns the filtered choices ``(karts, 5)`` for choices made from the latest input."""
        done, drifts = np.array(choices, np.int64), self._memory.drifts()
        backs, calls = self._memory.stuck()
        if not self._recovers:
            backs, calls = np.zeros_like(backs), np.zeros_like(calls)
        side = np.where(backs | calls, 0, self._drift_side(done, *drifts))
        turn = STEERS[done[:, _STEER]]
        if self._hold:
            uses = (done[:, _NITRO] == 1) & self._memory.may_boost & (self._views[:, _ENERGY] > 0)
            done[:, _NITRO] = uses
            begins = (side != 0) & (drifts[0] == 0)
            turn = np.where(side == 0, turn, side * np.clip(turn * side, *DRIFT_TURN))
            steer = steer_of_turn(side, turn, begins)
            done[:, _STEER] = np.where(side == 0, done[:, _STEER], _nearest(steer))
            done[:, _DRIFT] = side != 0
        is_left = self._views[:, _LINE] + self._views[:, _HEADING] > 0  # or heads left
        away = np.where(is_left, 0, CHOICES[_STEER] - 1)  # steering is inverted in reverse
        done[backs, _STEER], turn[backs] = away[backs], STEERS[away[backs]]
        done[backs, _PEDAL] = BRAKE
        done[calls, _PEDAL] = RESCUE
        nitro, fire = done[:, _NITRO] == 1, done[:, _FIRE] == 1
        self._memory.act(side.astype(np.intp), turn.astype(np.float32), nitro, fire)
        return done

    def forget(self, karts: slice | IntArray) -> None:
        """Resets some karts."""
        self._memory.forget(np.arange(len(self._has_moved))[karts])
        self._has_moved[karts], self.recurrent[karts] = False, 0.0

    def _drift_side(
        self, chosen: IntArray, before: IntArray, steps: IntArray, may_begin: BoolArray
    ) -> IntArray:
        """Returns the side to which each kart drifts now: 1 right, -1 left, 0 none."""
        turn, is_asked = STEERS[chosen[:, _STEER]], chosen[:, _DRIFT] == 1
        begins = is_asked & (np.abs(turn) >= START_STEER) & may_begin
        begins &= self._views[:, _SPEED] > _DRIFT_SPEED
        goes_on = is_asked | (steps < self._hold)
        goes_on &= turn * before > -_OTHER_SIDE
        kept = np.where(goes_on, before, 0)
        return np.where(before == 0, np.where(begins, np.sign(turn), 0), kept)


def steering(side: npt.NDArray[Any], turn: FloatArray, begins: npt.NDArray[np.bool_]) -> IntArray:
    """Returns the steering choices that give a turn; all arrays have broadcastable shapes.

    Args:
        side: side of the drift: 1 right, -1 left, 0 none.
        turn: turn, positive to the right [fraction of full lock].
        begins: whether a drift begins, which needs enough steering to that side.
    """
    return _nearest(np.where(begins, side * np.maximum(turn * side, START_STEER), turn))


def _nearest(turn: FloatArray) -> IntArray:
    return np.asarray(np.searchsorted(_BETWEEN, turn))
