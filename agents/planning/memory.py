"""Memory of drivers between steps, for any number of karts at once."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from . import BoolArray, FloatArray, IntArray
from ._planning import age_memory, write_memory
from .motion import BOOST_LASTS, BOOST_STEPS, DRIFT_APART, RELEASE_STEPS, RESCUE_STEPS, STEP
from .parameters import DriverParameters, rule_numbers

#: Upper limit of elapsed times [steps].
_LONG_AGO = 40.0

#: Number of marks along the road, starting at the kart, and their spacing [m].
MARK_COUNT, MARK_SPACING = 36, 3.0
LINE_MARKS = (MARK_SPACING * np.arange(MARK_COUNT + 1)).astype(np.float32)
#: Number of nearest karts to track.
RIVALS = 4
#: A moment at which nothing was observed: positions of the nearest karts, right and ahead,
#: ``(RIVALS, 2)`` [m]; velocity of the observing kart, right and ahead, ``(2,)`` [m/s]; directions
#: of the road ahead, ``(MARK_COUNT,)`` [rad].
_NO_MOMENT = np.zeros(2 * RIVALS + 2 + MARK_COUNT, np.float32)
_NO_MOMENT[: 2 * RIVALS] = 1e3

#: Entries of :meth:`DriverMemory.numbers`, and their signs in a mirrored race.
_SIGNS = {
    "turn": -1,
    "drift turn": -1,
    "drift side and time [3 s]": -1,
    "drift time [3 s]": 1,
    "turning on after a drift": 1,
    "boost": 1,
    "big boost": 1,
    "time to wait with nitro": 1,
    "caution": 1,
    "standing still": 1,
    "gain of speed [5 m/s]": 1,
    "time since the last shot": 1,
}
MEMORY_NAMES = tuple(_SIGNS)
MEMORY_SIZE = len(_SIGNS)
MEMORY_MIRROR = np.array(list(_SIGNS.values()), np.float32)


class PlanMemory(NamedTuple):
    """The memory of the drivers of ``A`` karts, ``(A,)`` float32 each. Times are in steps.

    Attributes:
        speed: forward speed in the last step [m/s].
        gain: change of speed in that step [m/s].
        turn: turn in that step, positive to the right [fraction of full lock].
        drift_turn: turn in the last step of a drift [fraction of full lock].
        drift_side: 1 in a drift to the right, -1 to the left, 0 outside drifts.
        drift_steps: duration of the drift so far.
        still_steps: time for which the kart has stood still.
        crawl_steps: time for which the kart has crawled.
        free_steps: time for which the kart has not stood still.
        reverses: number of times that the kart has reversed without getting free.
        lost_steps: time for which the kart has been far off the road.
        since_fire: time since the last shot.
        held_offset: steering offset from the plan that is held [fraction of full lock].
        hold_steps: remaining time of that offset; this and all attributes below count down to 0.
        hop_steps: time until another drift can begin.
        release_steps: remaining time of the turn after a drift.
        boost_steps: remaining time of the boost of a short drift.
        big_boost_steps: remaining time of the boost of a long drift.
        nitro_steps: remaining time of a burst of nitro.
        caution_steps: remaining time of caution after a crash.
        reverse_steps: remaining time of reversing.
        rescue_steps: remaining time of a rescue.
    """

    speed: FloatArray
    gain: FloatArray
    turn: FloatArray
    drift_turn: FloatArray
    drift_side: FloatArray
    drift_steps: FloatArray
    still_steps: FloatArray
    crawl_steps: FloatArray
    free_steps: FloatArray
    reverses: FloatArray
    lost_steps: FloatArray
    since_fire: FloatArray
    held_offset: FloatArray
    hold_steps: FloatArray
    hop_steps: FloatArray
    release_steps: FloatArray
    boost_steps: FloatArray
    big_boost_steps: FloatArray
    nitro_steps: FloatArray
    caution_steps: FloatArray
    reverse_steps: FloatArray
    rescue_steps: FloatArray


class DriverMemory:
    """The memory of A karts.

    Args:
        count: number of karts, A.
        rules: durations, and thresholds for crashes and for standing still.

    Attributes:
        rows: ``(22, A)`` float32, in the order of :class:`PlanMemory`.
        moments: ``(A, 2, 46)`` float32, observations in the step before and in this one, from which
            the extension computes the speeds of other karts: positions of the four nearest karts,
            velocity of the kart, and directions of the road ahead.
    """

    def __init__(self, count: int, rules: DriverParameters) -> None:
        self._rules = rules
        self._numbers = rule_numbers(rules)
        self.rows = np.zeros((len(PlanMemory._fields), count), np.float32)
        self._of = PlanMemory(*self.rows)
        self._of.since_fire[:] = _LONG_AGO
        self.moments = np.tile(_NO_MOMENT, (count, 2, 1))

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._of = PlanMemory(*self.rows)  # a copy needs views of its own array

    @classmethod
    def joined(cls, memories: Sequence[DriverMemory]) -> DriverMemory:
        """Returns the joint memory of several memories with equal rules."""
        joined = copy.copy(memories[0])
        joined.rows = np.concatenate([memory.rows for memory in memories], axis=1)
        joined._of = PlanMemory(*joined.rows)
        joined.moments = np.concatenate([memory.moments for memory in memories])
        return joined

    def take(self, joined: DriverMemory, rows: slice) -> None:
        """Copies the state of some karts from a joint memory."""
        self.rows[:] = joined.rows[:, rows]
        self.moments[:] = joined.moments[rows]

    def look(self, speed: FloatArray, skeed_factor: FloatArray) -> None:
        """Advances the memory by one step.

        Args:
            speed: ``(A,)`` forward speed [m/s].
            skeed_factor: ``(A,)`` skid factor.
        """
        speed, skeed_factor = (
            np.ascontiguousarray(numbers, np.float32) for numbers in (speed, skeed_factor)
        )
        age_memory(self._numbers, self.rows, speed, skeed_factor)
        self.moments[:, 0] = self.moments[:, 1]

    def look_around(self, beyond: FloatArray) -> None:
        """Completes the step once the road is known.

        Args:
            beyond: ``(A,)`` distance of the karts beyond the edge of the road [m].
        """
        of = self._of
        is_off = (beyond >= self._rules.lost_room) & (of.rescue_steps == 0)
        of.lost_steps[:] = np.where(is_off, of.lost_steps + 1, 0)

    def drifts(self) -> tuple[IntArray, IntArray, BoolArray]:
        """Returns the drifts of the karts, ``(A,)`` each.

        Returns:
            Side of the drift: 1 right, -1 left, 0 none; its duration so far [steps]; and whether a
                drift can begin.
        """
        of = self._of
        sides, steps = of.drift_side.astype(np.intp), of.drift_steps.astype(np.intp)
        return sides, steps, of.hop_steps == 0

    def numbers(self) -> FloatArray:
        """Returns the policy's inputs from the memory, ``(A, MEMORY_SIZE)``."""
        numbers = np.empty((self.rows.shape[1], MEMORY_SIZE), np.float32)
        self.write(numbers, 0)
        return numbers

    def write(self, out: FloatArray, first: int) -> None:
        """Writes :meth:`numbers` into columns of an array ``(A, F)``, from ``first`` on."""
        write_memory(self._numbers, self.rows, out, first)

    def held(self) -> tuple[FloatArray, FloatArray]:
        """Returns the held offsets and the fractions of their time that remain, ``(A,)``."""
        return self._of.held_offset, self._of.hold_steps / np.float32(self._rules.turn_hold)

    def hold(self, offset: FloatArray) -> None:
        """Records the steering offsets of karts that hold none.

        Args:
            offset: ``(A,)`` offset from the plan [fraction of full lock].
        """
        is_free = self._of.hold_steps == 0
        self._of.held_offset[is_free] = offset[is_free]
        self._of.hold_steps[is_free] = self._rules.turn_hold

    @property
    def may_boost(self) -> BoolArray:
        """Returns whether the last burst of nitro is over, ``(A,)`` bool."""
        return np.asarray(self._of.nitro_steps == 0)

    def stuck(self) -> tuple[BoolArray, BoolArray]:
        """Updates stuck karts; returns which reverse and which call the rescue, ``(A,)``."""
        of = self._of
        is_lost = of.lost_steps * STEP > self._rules.lost_time
        is_stuck = of.still_steps > round(self._rules.stuck_time / STEP)
        is_stuck |= of.crawl_steps * STEP > self._rules.crawl_time
        begins = (of.reverse_steps == 0) & (is_lost | is_stuck)
        calls = begins & (is_lost | (of.reverses >= self._rules.rescue_reverses))
        backs = begins & ~calls
        of.still_steps[begins] = of.crawl_steps[begins] = of.lost_steps[begins] = 0
        of.drift_side[begins] = of.drift_steps[begins] = 0
        of.reverses[calls] = -self._rules.rescued_reverses
        of.rescue_steps[calls] = RESCUE_STEPS
        of.reverses[backs] += 1
        of.reverse_steps[backs] = round(self._rules.reverse_time / STEP)
        return of.reverse_steps > 0, calls

    def act(self, side: IntArray, turn: FloatArray, nitro: BoolArray, fire: BoolArray) -> BoolArray:
        """Records the actions of the karts.

        Args:
            side: ``(A,)`` side of the drift: 1 right, -1 left, 0 none.
            turn: ``(A,)`` turn, positive to the right [fraction of full lock].
            nitro: ``(A,)`` bool.
            fire: ``(A,)`` bool.

        Returns:
            ``(A,)`` bool, whether a drift begins.
        """
        of = self._of
        ends = (of.drift_side != 0) & (side == 0)
        earns_big = ends & (of.drift_steps >= BOOST_STEPS[1])
        earns = ends & ~earns_big & (of.drift_steps >= BOOST_STEPS[0])
        of.big_boost_steps[earns_big] = BOOST_LASTS[1]
        of.boost_steps[earns] = BOOST_LASTS[0]
        of.release_steps[ends] = np.minimum(of.drift_steps[ends], RELEASE_STEPS)
        begins: BoolArray = (side != 0) & (of.drift_side == 0)
        of.drift_steps[begins] = 0
        of.hop_steps[begins] = DRIFT_APART
        of.drift_side[:] = side
        of.drift_steps[:] = np.where(side != 0, of.drift_steps + 1, 0)
        of.turn[:] = turn
        of.drift_turn[:] = np.where(side != 0, turn, of.drift_turn)
        of.nitro_steps[nitro] = round(self._rules.nitro_wait / STEP)
        of.since_fire[fire] = 0
        return begins

    def forget(self, rows: IntArray) -> None:
        """Resets some karts."""
        self.rows[:, rows] = 0
        self._of.since_fire[rows] = _LONG_AGO
        self.moments[rows] = _NO_MOMENT
