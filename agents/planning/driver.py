"""Karts driven by a policy over plans: the policy's inputs and the effect of its choices.

In each step a policy makes four choices: which maneuver to begin (go on, brake, drift left, drift
right), a steering offset from the best plan for that maneuver, whether to use nitro, and whether
to fire. It starts from a *prior*, logits that follow from the worth of the plans; learned logits
are added to them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stkzoo import Phase
from stkzoo.mdp import action_of
from stkzoo.wrappers.racing import (
    LOOKS,
    MIRROR,
    OWN_PLACES,
    SIZE,
    Surroundings,
    racing_features,
    surroundings_of,
)

from . import BoolArray, FloatArray, IntArray
from .memory import LINE_MARKS, MEMORY_MIRROR, MEMORY_NAMES, RIVALS, DriverMemory
from .motion import DRIFT_TURN
from .parameters import DriverParameters
from .plans import BRAKE, DRIFT_LEFT, DRIFT_RIGHT, FREE, MANEUVERS
from .worth import PlanOptions, weigh

#: Steering offsets from the plan [fraction of full lock].
OFFSETS = np.array([-0.45, -0.2, -0.08, 0.0, 0.08, 0.2, 0.45], np.float32)

#: Names of the choices, their numbers of options, and the slices of their logits.
CHOICE_NAMES = ("begin", "turn", "nitro", "fire")
CHOICES = (MANEUVERS, len(OFFSETS), 2, 2)
_ENDS = np.cumsum(CHOICES)
HEADS = tuple(slice(int(e) - n, int(e)) for e, n in zip(_ENDS, CHOICES, strict=True))

_TURN = CHOICE_NAMES.index("turn")

#: Columns of the own state: the forward speed [m/s] and the skid factor.
_SPEED, _SKEED = OWN_PLACES["velocity"].start + 2, OWN_PLACES["skeed_factor"].start

#: Distances at which the road is observed [m].
ALL_LOOKS = np.concatenate([LOOKS, LINE_MARKS])

#: Logit of an offset other than the held one.
_NOT_HELD = np.float32(-1e3)

#: Buttons in the order of the controls.
BUTTONS = ("brake", "drift", "fire", "nitro", "rescue")

#: Minimum steering at the start of a drift, whose sign determines the side.
START_STEER = 0.3

_OPTION_SIGNS = np.array([1, 1, -1, 1], np.float32)
_ROAD_SIGNS = np.array([-1, -1, 1], np.float32)
_RIVAL_SIGNS = np.tile(np.array([1, 1, -1, 1, -1], np.float32), RIVALS)
#: Signs of the held offset and of its remaining time.
_HOLD_SIGNS = np.array([-1, 1], np.float32)
_OPTIONS_AT = SIZE + len(MEMORY_MIRROR)
_PLAN_TURNS = _OPTIONS_AT + 4 * np.arange(MANEUVERS) + 2
_DRIFT_TIME = SIZE + MEMORY_NAMES.index("drift time [3 s]")
#: Number of inputs of a policy whose offsets do not hold; the held offset and its time follow.
INPUT_SIZE_WITHOUT_HOLD = _OPTIONS_AT + 4 * MANEUVERS + len(_ROAD_SIGNS) + len(_RIVAL_SIGNS)
INPUT_SIZE = INPUT_SIZE_WITHOUT_HOLD + len(_HOLD_SIGNS)


def _mirror() -> tuple[IntArray, FloatArray]:
    """Returns the permutation and the signs that mirror the inputs."""
    order = np.arange(INPUT_SIZE)
    left, right = (_OPTIONS_AT + 4 * drift + np.arange(4) for drift in (DRIFT_LEFT, DRIFT_RIGHT))
    order[left], order[right] = right, left
    options = np.tile(_OPTION_SIGNS, MANEUVERS)
    signs = [MIRROR, MEMORY_MIRROR, options, _ROAD_SIGNS, _RIVAL_SIGNS, _HOLD_SIGNS]
    return order, np.concatenate(signs)


_MIRROR_ORDER, _MIRROR_SIGNS = _mirror()
_SWAPPED = np.array([FREE, BRAKE, DRIFT_RIGHT, DRIFT_LEFT])
_PRIOR_ORDER = np.concatenate(
    [
        _SWAPPED,
        MANEUVERS + np.arange(len(OFFSETS))[::-1],
        np.arange(MANEUVERS + len(OFFSETS), int(_ENDS[-1])),
    ]
)


def mirrored_inputs(inputs: FloatArray) -> FloatArray:
    """Mirrors inputs ``(..., INPUT_SIZE)`` left to right."""
    mirrored: FloatArray = inputs[..., _MIRROR_ORDER] * _MIRROR_SIGNS
    return mirrored


def mirrored_prior(prior: FloatArray) -> FloatArray:
    """Mirrors the prior left to right."""
    return prior[..., _PRIOR_ORDER]


def mirrored_choices(choices: IntArray) -> IntArray:
    """Mirrors choices ``(..., 4)`` left to right."""
    mirrored: IntArray = choices.copy()
    mirrored[..., 0] = _SWAPPED[choices[..., 0]]
    mirrored[..., 1] = len(OFFSETS) - 1 - choices[..., 1]
    return mirrored


def plan_turns(inputs: FloatArray) -> FloatArray:
    """Returns the turn of each maneuver's best plan, ``(A, 4)`` [fraction of full lock]."""
    turns: FloatArray = inputs[:, _PLAN_TURNS]
    return turns


def is_drifting(inputs: FloatArray) -> BoolArray:
    """Returns whether each kart is in a drift, ``(A,)`` bool."""
    return np.asarray(inputs[:, _DRIFT_TIME] > 0)


@dataclass(frozen=True, slots=True)
class PolicyInput:
    """Input of a policy for A karts.

    Attributes:
        inputs: ``(A, INPUT_SIZE)`` float32; empty for a policy that needs only the prior.
        prior: ``(A, sum(CHOICES))`` float32.
    """

    inputs: FloatArray
    prior: FloatArray


class PlanDriver:
    """Drives A karts by choices among their best plans, and keeps the state for that.

    Args:
        count: number of karts, A.
        rules: parameters of the plans.

    Attributes:
        memory: what the karts' drivers remember.
        options: the best plans for the latest observation.
    """

    options: PlanOptions

    def __init__(self, count: int, rules: DriverParameters | None = None) -> None:
        self._rules = rules or DriverParameters()
        self._holds_turns = self._rules.turn_hold > 1
        self.memory = DriverMemory(count, self._rules)

    def drive(
        self,
        observation: Mapping[str, Any],
        choose: Callable[[PolicyInput], IntArray] | None = None,
    ) -> dict[str, Any]:
        """Returns the action of one kart; call it once per step.

        Args:
            observation: observation in the ``full`` view.
            choose: returns a policy's choices ``(1, 4)``; ``None`` takes the prior's most likely
                ones.

        Returns:
            An action of the ``full`` view.
        """
        return self.drive_together([self], [observation], choose)[0]

    @staticmethod
    def drive_together(
        drivers: Sequence[PlanDriver],
        observations: Sequence[Mapping[str, Any]],
        choose: Callable[[PolicyInput], IntArray] | None = None,
    ) -> list[dict[str, Any]]:
        """Returns the same actions as :meth:`drive` for each driver, bit for bit, in less time.

        Args:
            drivers: drivers of one kart each, with equal rules.
            observations: their observations, also from different races.
            choose: returns a policy's choices ``(A, 4)``; each row must depend only on its own
                kart.
        """
        controls = np.eye(1, 7, dtype=np.float32).repeat(len(drivers), 0)  # full throttle
        racing = [n for n, seen in enumerate(observations) if seen["phase"] >= Phase.GO_PHASE]
        if racing:
            active = [drivers[number] for number in racing]
            driver = active[0] if len(active) == 1 else PlanDriver._joined(active)
            looks = LINE_MARKS if choose is None else ALL_LOOKS
            around = surroundings_of([observations[number] for number in racing], looks)
            seen = driver.look(around, has_inputs=choose is not None)
            chosen = likeliest(seen.prior) if choose is None else choose(seen)
            controls[racing], _ = driver.act(chosen)
            if len(active) > 1:
                for row, one in enumerate(active):
                    one.memory.take(driver.memory, slice(row, row + 1))
        return list(map(action_of, controls))

    @classmethod
    def _joined(cls, drivers: Sequence[PlanDriver]) -> PlanDriver:
        joined = cls(0, drivers[0]._rules)
        joined.memory = DriverMemory.joined([driver.memory for driver in drivers])
        return joined

    def look(self, around: Surroundings, *, has_inputs: bool = True) -> PolicyInput:
        """Advances the state by one step and returns the policy's input.

        Args:
            around: surroundings of the karts, with the road at :data:`ALL_LOOKS`; at
                :data:`.memory.LINE_MARKS` if there are no inputs.
            has_inputs: whether to compute the inputs, and not only the prior.
        """
        self.memory.look(around.ego[:, _SPEED], around.ego[:, _SKEED])
        seen = self.view(around, has_inputs=has_inputs)
        self.memory.look_around(self.options.beyond)
        return seen

    def view(self, around: Surroundings, *, has_inputs: bool = True) -> PolicyInput:
        """Returns the policy's input without advancing the state; see :meth:`look`."""
        shape = (len(around.road), INPUT_SIZE) if has_inputs else (0, 0)
        inputs = np.empty(shape, np.float32)
        if has_inputs:
            racing_features(around, inputs)
            self.memory.write(inputs, SIZE)
        self.options = weigh(self._rules, self.memory, around, inputs, _OPTIONS_AT)
        self._hold(self.options.prior, inputs)
        return PolicyInput(inputs, self.options.prior)

    def _hold(self, prior: FloatArray, inputs: FloatArray) -> None:
        """Makes a held offset the only choice; writes it and its time to the inputs, if any."""
        if not self._holds_turns:
            inputs[:, INPUT_SIZE_WITHOUT_HOLD:] = 0
            return
        offset, left = self.memory.held()
        if len(inputs):
            inputs[:, INPUT_SIZE_WITHOUT_HOLD:] = np.stack([offset, left], axis=1)
        rows = np.flatnonzero(left)
        is_held = offset[rows, None] == OFFSETS
        prior[rows, HEADS[_TURN]] = np.where(is_held, np.float32(0), _NOT_HELD)

    def moves(self, choices: IntArray) -> tuple[IntArray, FloatArray]:
        """Converts choices ``(A, 4)`` to drift sides and turns [fraction of full lock]."""
        begin, offset = choices[:, 0], choices[:, 1]
        side = (begin == DRIFT_RIGHT).astype(np.intp) - (begin == DRIFT_LEFT)
        turn = self.options.turn[np.arange(len(choices)), begin] + OFFSETS[offset]
        return side, np.minimum(np.maximum(turn, -1.0), 1.0)

    def act(self, choices: IntArray) -> tuple[FloatArray, BoolArray]:
        """Returns the controls for choices.

        Args:
            choices: ``(A, 4)``.

        Returns:
            Controls ``(A, 7)`` in the order of ``stkzoo.engine.snapshot.CONTROLS``; and ``(A,)``
                bool, whether the choices apply: a stuck kart frees itself instead.
        """
        options = self.options
        side, turn = self.moves(choices)
        begin, _, nitro, fire = choices.T
        backs, calls = self.memory.stuck()
        away = np.where(options.angle + 0.1 * options.offset < 0, -1.0, 1.0)
        is_driven = ~(backs | calls)
        side = np.where(is_driven, side, 0)
        turn = np.where(backs, away, turn).astype(np.float32)
        if self._holds_turns:
            self.memory.hold(OFFSETS[choices[:, _TURN]])
        uses = is_driven & (nitro == 1)
        fires = is_driven & (fire == 1)
        begins = self.memory.act(side, turn, uses, fires)
        brakes = backs | (is_driven & (begin == BRAKE))
        controls = np.zeros((len(choices), 7), np.float32)
        controls[:, 0] = ~brakes & ~calls
        controls[:, 1] = steer_of_turn(side, turn, begins)
        controls[:, 2] = brakes
        controls[:, 3] = side != 0
        controls[:, 4] = fires
        controls[:, 5] = uses
        controls[:, 6] = calls
        return controls, is_driven


def likeliest(logits: FloatArray) -> IntArray:
    """Returns the most likely choices ``(A, 4)`` for logits ``(A, sum(CHOICES))``."""
    return np.stack([logits[:, head].argmax(axis=1) for head in HEADS], axis=1)


def steer_of_turn(side: IntArray, turn: FloatArray, begins: BoolArray) -> FloatArray:
    """Returns the steering that gives a turn, also during drifts.

    Args:
        side: ``(A,)`` side of the drift: 1 right, -1 left, 0 none.
        turn: ``(A,)`` turn, positive to the right [fraction of full lock].
        begins: ``(A,)`` bool, whether the drift begins now.
    """
    least, most = DRIFT_TURN
    inwards = 2.0 * (turn * side - least) / (most - least) - 1.0
    inwards = np.where(begins, np.maximum(inwards, START_STEER), inwards)
    inwards = np.minimum(np.maximum(inwards, -1.0), 1.0)
    steer = np.where(side == 0, np.minimum(np.maximum(turn, -1.0), 1.0), side * inwards)
    return steer.astype(np.float32)
