"""A stateful filter between a policy's choices and a kart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning.arrays import FloatArray, IntArray
from stkzoo.agents.planning.driver import START_STEER, steer_of_turn
from stkzoo.agents.planning.kart import DRIFT_TURN
from stkzoo.agents.planning.memory import MEMORY_MIRROR, MEMORY_SIZE, DriverMemory, KartSituation
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.wrappers.racing import BRAKE, CHOICES, MIRROR, PLACES, RESCUE, SIZE, STEERS

#: How many numbers a policy sees with the filter: the view, and the filter's memory.
INPUT_SIZE = SIZE + MEMORY_SIZE
#: It times this is what would be seen if left were right.
INPUT_MIRROR = np.concatenate([MIRROR, MEMORY_MIRROR])

#: The columns of choices.
_STEER, _PEDAL, _DRIFT, _NITRO, _FIRE = range(5)
#: Where the view has the speed forwards [20 m/s] and other parts, vectors by their first number.
_SPEED = PLACES["velocity"].start + 2
_SKEED, _ENERGY, _LINE, _ROOM, _HEADING = (
    PLACES[part].start
    for part in ("skeed_factor", "energy", "line_position", "line_room", "marks_heading")
)
#: A drift begins to the side to which the kart steers, if so much and at such a speed [20 m/s];
#: steering so much to the other side ends it.
_DRIFT_SPEED, _OTHER_SIDE = 10.0 / 20.0, 0.3
#: What lies between two choices of steering belongs to the nearer one.
_BETWEEN = (STEERS[1:] + STEERS[:-1]) / 2
#: A kart that has been so fast has left its place on the grid [20 m/s].
_MOVES = 3.0 / 20.0


class ActionFilter:
    """Changes a policy's choices by what the karts remember, which the policy sees too.

    - **Drifts last.** A drift pays after a second. A policy that chooses at random in each step
      whether to go on rarely gets that far, so the filter holds a drift for a minimum time. The
      game also turns a drifting kart by other shares of full lock; the filter steers so that the
      kart turns as much as the same choice would without a drift, within a drift's limits. Steering
      to the other side ends the drift.
    - **Nitro is not wasted.** One burst ends before the next begins.
    - **Stuck karts free themselves**, as those of the planner do.

    Args:
        karts: how many.
        hold: for how many steps a drift goes on at least; 0 leaves drifts and nitro to the choices.
        memory: theirs, if the caller keeps it up to date and never calls :meth:`look`.
    """

    def __init__(self, karts: int, hold: int, memory: DriverMemory | None = None) -> None:
        self._hold = hold
        self._memory = memory or DriverMemory(karts, DriverParameters())
        self._has_moved = np.zeros(karts, np.bool_)
        self._views = np.zeros((karts, SIZE), np.float32)

    def drive(self, observation: FloatArray, choose: Callable[[FloatArray], IntArray]) -> IntArray:
        """The choices ``(5,)`` of the one kart, once a step.

        Args:
            observation: of the view ``racing``, ``(165,)``.
            choose: a policy's choices ``(1, 5)``.
        """
        return self.drive_together([self], [observation], choose)[0]

    @staticmethod
    def drive_together(
        filters: Sequence[ActionFilter],
        observations: Sequence[FloatArray],
        choose: Callable[[FloatArray], IntArray],
    ) -> list[IntArray]:
        """The choices that :meth:`drive` gives each, to the bit, in less time.

        Args:
            filters: of one kart each, which hold drifts equally long.
            observations: theirs.
            choose: a policy's choices ``(A, 5)``, none of which depends on the other karts.
        """
        joined = filters[0] if len(filters) == 1 else ActionFilter._joined(filters)
        done = joined.apply(choose(joined.look(np.stack(observations))))
        if len(filters) > 1:
            for row, own in enumerate(filters):
                own._memory.take(joined._memory, slice(row, row + 1))
                own._has_moved = joined._has_moved[row : row + 1]
        return list(done)

    @classmethod
    def _joined(cls, filters: Sequence[ActionFilter]) -> ActionFilter:
        memory = DriverMemory.joined([own._memory for own in filters])
        joined = cls(0, filters[0]._hold, memory)
        joined._has_moved = np.concatenate([own._has_moved for own in filters])
        return joined

    def look(self, views: FloatArray) -> FloatArray:
        """A step has passed.

        Args:
            views: ``(karts, 165)``.

        Returns:
            What the policy sees, ``(karts, 177)``: the views, and what is remembered.
        """
        self._memory.look(20.0 * views[:, _SPEED], views[:, _SKEED])
        aside = np.hypot(views[:, _LINE], views[:, _LINE + 2]) - views[:, _ROOM]
        self._memory.look_around(10.0 * aside)
        self._has_moved |= np.abs(views[:, _SPEED]) > _MOVES
        self._memory.forget(np.flatnonzero(~self._has_moved))  # on the grid all stand still
        return self.see(views)

    def see(self, views: FloatArray) -> FloatArray:
        """What the policy sees when no step has passed."""
        self._views = views
        return np.concatenate([views, self._memory.numbers()], axis=1)

    def apply(self, choices: npt.NDArray[Any]) -> IntArray:
        """What is done of one step's choices ``(karts, 5)``, made by what was seen last."""
        done, now = np.array(choices, np.int64), self._memory.situation()
        backs, calls = self._memory.stuck()
        side = np.where(backs | calls, 0, self._drift_side(done, now))
        turn = STEERS[done[:, _STEER]]
        if self._hold:
            uses = (done[:, _NITRO] == 1) & self._memory.may_boost & (self._views[:, _ENERGY] > 0)
            done[:, _NITRO] = uses
            begins = (side != 0) & (now.drift_side == 0)
            turn = np.where(side == 0, turn, side * np.clip(turn * side, *DRIFT_TURN))
            steer = steer_of_turn(side, turn, begins)
            done[:, _STEER] = np.where(side == 0, done[:, _STEER], _nearest(steer))
            done[:, _DRIFT] = side != 0
        is_left = self._views[:, _LINE] + self._views[:, _HEADING] > 0  # of the road, or its way
        away = np.where(is_left, 0, CHOICES[_STEER] - 1)  # backwards a kart turns the other way
        done[backs, _STEER], turn[backs] = away[backs], STEERS[away[backs]]
        done[backs, _PEDAL] = BRAKE
        done[calls, _PEDAL] = RESCUE
        nitro, fire = done[:, _NITRO] == 1, done[:, _FIRE] == 1
        self._memory.act(side.astype(np.intp), turn.astype(np.float32), nitro, fire)
        return done

    def forget(self, karts: slice) -> None:
        """Resets some karts."""
        self._memory.forget(np.arange(len(self._has_moved))[karts])
        self._has_moved[karts] = False

    def _drift_side(self, chosen: IntArray, now: KartSituation) -> IntArray:
        """To which side karts drift now: 1 to the right, -1 to the left, 0 for not at all."""
        turn, is_asked = STEERS[chosen[:, _STEER]], chosen[:, _DRIFT] == 1
        begins = is_asked & (np.abs(turn) >= START_STEER) & now.may_hop
        begins &= self._views[:, _SPEED] > _DRIFT_SPEED
        goes_on = is_asked | (now.drift_steps < self._hold)
        goes_on &= turn * now.drift_side > -_OTHER_SIDE
        kept = np.where(goes_on, now.drift_side, 0)
        return np.where(now.drift_side == 0, np.where(begins, np.sign(turn), 0), kept)


def steering(side: npt.NDArray[Any], turn: FloatArray, begins: npt.NDArray[np.bool_]) -> IntArray:
    """Which choices of steering make karts turn as they should, arrays of one shape or alike.

    Args:
        side: to which they drift: 1 to the right, -1 to the left, 0 not at all.
        turn: share of full lock, positive to the right.
        begins: whose drift begins: they steer far enough to that side.
    """
    return _nearest(np.where(begins, side * np.maximum(turn * side, START_STEER), turn))


def _nearest(turn: FloatArray) -> IntArray:
    return np.asarray(np.searchsorted(_BETWEEN, turn))
