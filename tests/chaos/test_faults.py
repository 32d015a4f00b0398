"""Processes are killed, stopped or interrupted, in every form.

The moment, process and signal of a drawn fault depend on its number. ``make test-all`` injects a
hundred of them; to inject more, set ``STKZOO_FAULTS=1000``. To repeat one, run
``test_a_drawn_fault[137]``.
"""

import os
import random

import pytest

from tests.chaos.faults import OUTSIDE, Fault, draw_fault
from tests.chaos.forms import FORMS
from tests.chaos.programs import PROGRAMS, ProgramTrials
from tests.chaos.trial import Trials

pytestmark = pytest.mark.slow

#: Relative frequency of each form and program among drawn faults.
WEIGHTS = {
    "ParallelEnv": 6,
    "Gymnasium id": 3,
    "RaceVectorEnv": 5,
    "drawn by the game": 1,
    "run_race": 3,
    "a program": 2,
    "a program that spawns": 1,
    "stkzoo race": 2,
    "a video": 1,
    "stkzoo tournament": 1,
}


@pytest.fixture(scope="module")
def outside():
    with ProgramTrials() as trials:
        yield trials


@pytest.fixture(scope="module")
def inside(outside):  # the other trials have their folder elsewhere
    del outside
    with Trials() as trials:
        yield trials


@pytest.mark.parametrize(
    ("form", "moment", "target", "signal"),
    [
        ("ParallelEnv", "step", "race", "SIGSTOP"),
        ("ParallelEnv", "save", "race", "SIGSEGV"),
        ("Gymnasium id", "reset", "program", "SIGINT"),
        ("RaceVectorEnv", "step", "race", "SIGKILL"),
        pytest.param("drawn by the game", "render", "drawing", "SIGKILL", marks=pytest.mark.matrix),
        ("run_race", "race", "agent", "SIGKILL"),
    ],
)
def test_after_a_fault_the_next_race_is_unchanged_and_nothing_is_left(
    inside, form, moment, target, signal
):
    fault = Fault(form=form, moment=moment, target=target, signal=signal, share=0.5, choice=0.0)
    outcome = inside.run(fault)
    assert outcome.survived, outcome.problem


@pytest.mark.parametrize("target", ["race", "fork server"])
def test_a_game_killed_during_steps_raises_an_error(inside, target):
    """Tests the harness itself: signals reach the process and the form raises an error."""
    answers = []
    for number in range(8):  # on a busy machine, a signal may come after the last step
        fault = Fault(
            form="ParallelEnv",
            moment="step",
            target=target,
            signal="SIGKILL",
            share=0.3 / (1 + number),
            choice=0.0,
        )
        outcome = inside.run(fault)
        assert outcome.survived, outcome.problem
        assert outcome.injected
        answers.append(outcome.answer)
        if outcome.answer == "EngineCrashed":
            return
    pytest.fail(f"no crash: {answers}")


@pytest.mark.parametrize(
    ("program", "target", "signal"),
    [
        ("a program", "program", "SIGKILL"),
        ("a program that spawns", "program", "SIGKILL"),
        ("stkzoo race", "program", "SIGINT"),
        ("stkzoo race", "program", "SIGKILL"),
        ("stkzoo race", "agent", "SIGSEGV"),
        pytest.param("stkzoo tournament", "program", "SIGKILL", marks=pytest.mark.matrix),
        ("a video", "encoder", "SIGKILL"),
    ],
)
def test_a_program_reports_a_fault_and_leaves_nothing(outside, program, target, signal):
    fault = Fault(
        form=program, moment=OUTSIDE[0], target=target, signal=signal, share=0.7, choice=0.0
    )
    outcome = outside.run(fault)
    assert outcome.survived, outcome.problem


def drawn_fault(number):
    """Returns the fault with a number."""
    chance = random.Random(f"1/{number}")
    name = chance.choices(list(WEIGHTS), list(WEIGHTS.values()))[0]
    if name in FORMS:
        return draw_fault(chance, name, FORMS[name].moments, FORMS[name].targets)
    return draw_fault(chance, name, OUTSIDE, PROGRAMS[name].targets)


@pytest.mark.matrix
@pytest.mark.parametrize("number", range(int(os.environ.get("STKZOO_FAULTS", "100"))))
def test_a_drawn_fault(inside, outside, number):
    fault = drawn_fault(number)
    outcome = (inside if fault.form in FORMS else outside).run(fault)
    assert outcome.survived, (fault, outcome.problem)
