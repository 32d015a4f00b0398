"""Candidates of the search: changes of a base policy's choices for some steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stkzoo.agents.planning import FloatArray, IntArray
from stkzoo.agents.planning.driver import HEADS, OFFSETS, PolicyInput, likeliest
from stkzoo.agents.planning.plans import MANEUVERS
from stkzoo.agents.planning.worth import LEAST_LOGIT

#: Returns a policy's choices ``(A, 4)``; ``None`` takes the prior's most likely ones.
Choose = Callable[[PolicyInput], IntArray]

#: Number by which a candidate changes the index of the offset.
_SHIFTS = (-3, -2, -1, 1, 2, 3)
#: A maneuver without a plan at the moment has at most this logit in the prior.
_NO_PLAN = LEAST_LOGIT + 1
_BEGIN, _TURN, _NITRO = range(3)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A change of the base policy's choices that holds for several steps.

    Attributes:
        shift: added to the index of the chosen offset in
            :data:`stkzoo.agents.planning.driver.OFFSETS`.
        steps: number of steps for which the change holds.
        maneuver: maneuver instead of the chosen one; ``None`` keeps the chosen one.
        flips_nitro: whether nitro is used if the base policy does not use it, and the reverse.
    """

    shift: int = 0
    steps: int = 0
    maneuver: int | None = None
    flips_nitro: bool = False

    def rest(self, done: int) -> Candidate:
        """Returns what remains of the candidate after some steps."""
        return replace(self, steps=max(self.steps - done, 0))

    def change(self, choices: IntArray, begin: FloatArray, step: int) -> None:
        """Changes the choices of one kart in a step.

        Args:
            choices: ``(4,)`` choices of the base policy, which change.
            begin: ``(4,)`` the prior's logits of the maneuvers.
            step: number of steps since the candidate began.
        """
        if step >= self.steps:
            return
        if self.maneuver is not None and begin[self.maneuver] > _NO_PLAN:
            choices[_BEGIN] = self.maneuver
        choices[_NITRO] ^= self.flips_nitro
        choices[_TURN] = np.clip(choices[_TURN] + self.shift, 0, len(OFFSETS) - 1)


def draw_candidate(
    random: np.random.Generator,
    holds: Sequence[int],
    maneuver_chance: float = 0.0,
    nitro_chance: float = 0.0,
) -> Candidate:
    """Draws a candidate.

    Args:
        random: source of random numbers.
        holds: numbers of steps for which a candidate may hold.
        maneuver_chance: probability that it has a maneuver of its own.
        nitro_chance: probability that it changes the use of nitro.
    """
    shift, steps = int(random.choice(_SHIFTS)), int(random.choice(holds))
    maneuver = int(random.integers(MANEUVERS))
    is_other, flips_nitro = random.random(2) < (maneuver_chance, nitro_chance)
    return Candidate(shift, steps, maneuver if is_other else None, bool(flips_nitro))


def changed(choose: Choose | None, candidates: Sequence[Candidate], step: int) -> Choose:
    """Returns the base policy with the change of one candidate for each kart.

    Args:
        choose: the base policy.
        candidates: one candidate for each row of the policy's input.
        step: number of steps since the candidates began.
    """

    def choose_changed(view: PolicyInput) -> IntArray:
        chosen = likeliest(view.prior) if choose is None else choose(view)
        for candidate, row, prior in zip(candidates, chosen, view.prior, strict=True):
            candidate.change(row, prior[HEADS[_BEGIN]], step)
        return chosen

    return choose_changed
