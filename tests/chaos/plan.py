"""The fault for each number."""

from __future__ import annotations

import random

from tests.chaos.faults import OUTSIDE, Fault, draw_fault
from tests.chaos.forms import FORMS
from tests.chaos.programs import PROGRAMS

__all__ = ["WEIGHTS", "fault_of"]

#: Relative frequency of each form and program.
WEIGHTS = {
    "ParallelEnv": 6,
    "AEC": 2,
    "Gymnasium id": 3,
    "RaceVectorEnv": 5,
    "RaceVecEnv": 2,
    "drawn by the game": 1,
    "run_race": 3,
    "a program": 2,
    "a program that spawns": 1,
    "a program of many races": 1,
    "stkzoo race": 2,
    "a video": 1,
    "stkzoo tournament": 1,
}


def fault_of(seed: int, number: int) -> Fault:
    """Returns the fault with a number. Equal arguments give equal faults."""
    chance = random.Random(f"{seed}/{number}")
    name = chance.choices(list(WEIGHTS), list(WEIGHTS.values()))[0]
    if name in FORMS:
        return draw_fault(chance, name, FORMS[name].moments, FORMS[name].targets)
    return draw_fault(chance, name, OUTSIDE, PROGRAMS[name].targets)
