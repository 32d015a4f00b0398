"""Processes are killed, stopped or interrupted at random moments, in every form.

To inject thousands of faults, run ``python -m benchmarks.chaos``.
"""

import contextlib
import random
import re
import time
from dataclasses import replace
from pathlib import Path

import pytest

from tests.chaos.family import family
from tests.chaos.faults import OUTSIDE, Fault, draw_fault
from tests.chaos.forms import FORMS
from tests.chaos.plan import WEIGHTS, fault_of
from tests.chaos.programs import PROGRAMS, ProgramTrials
from tests.chaos.trial import Trials

pytestmark = pytest.mark.slow

#: Number of faults per form.
INSIDE = {"ParallelEnv": 5, "AEC": 1, "Gymnasium id": 2, "RaceVectorEnv": 2, "run_race": 1}


@pytest.fixture(scope="module")
def inside():
    with Trials() as trials:
        yield trials


@pytest.fixture(scope="module")
def outside():
    with ProgramTrials() as trials:
        yield trials


@pytest.mark.parametrize("name", INSIDE)
def test_after_a_fault_the_next_race_is_unchanged_and_nothing_is_left(inside, name):
    chance, form = random.Random(name), FORMS[name]
    for _ in range(INSIDE[name]):
        fault = draw_fault(chance, name, form.moments, form.targets)
        if fault.signal == "SIGSTOP":  # SIGSTOP waits for timeouts; other tests cover it
            fault = replace(fault, signal="SIGKILL")
        outcome = inside.run(fault)
        assert outcome.survived, (fault, outcome.problem)


@pytest.mark.parametrize(
    ("form", "moment", "signal"),
    [("RaceVecEnv", "step", "SIGKILL"), ("drawn by the game", "render", "SIGKILL")],
)
def test_slow_forms_recover_from_a_fault(inside, form, moment, signal):
    target = "drawing" if form == "drawn by the game" else "race"
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
        ("stkzoo tournament", "program", "SIGKILL"),
        ("a video", "encoder", "SIGKILL"),
    ],
)
def test_a_program_reports_a_fault_and_leaves_nothing(outside, program, target, signal):
    fault = Fault(
        form=program, moment=OUTSIDE[0], target=target, signal=signal, share=0.7, choice=0.0
    )
    outcome = outside.run(fault)
    assert outcome.survived, outcome.problem


def test_a_number_always_gives_the_same_fault():
    faults = [fault_of(1, number) for number in range(300)]
    assert faults == [fault_of(1, number) for number in range(300)]
    assert {fault.form for fault in faults} == set(WEIGHTS) == {*FORMS, *PROGRAMS}
    assert faults != [fault_of(2, number) for number in range(300)]


def test_no_process_uses_shared_memory(outside):
    """No process creates shared memory, so none can remain in ``/dev/shm`` after a fault."""
    seen = set()
    for name in ("stkzoo race", "a program of many races"):
        run = outside.start(name)
        try:
            while run.is_running:
                time.sleep(0.1)
                for member in family(run.pid):
                    with contextlib.suppress(OSError):
                        maps = Path(f"/proc/{member.pid}/maps").read_text()
                        assert not re.search(r" /dev/shm/| /SYSV", maps), maps
                        seen.add(member.kind)
        finally:
            run.close()
    assert {"race", "fork server", "agent"} <= seen
