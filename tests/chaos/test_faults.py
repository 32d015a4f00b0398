"""Processes killed, stopped and interrupted at random moments of every form.

By hand, and by the thousand: ``python -m benchmarks.chaos``.
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

#: How many faults each form gets here.
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
def test_whatever_is_hit_the_next_race_is_as_ever_and_nothing_is_left(inside, name):
    chance, form = random.Random(name), FORMS[name]
    for _ in range(INSIDE[name]):
        fault = draw_fault(chance, name, form.moments, form.targets)
        if fault.signal == "SIGSTOP":  # whose time-outs take long; other tests have them
            fault = replace(fault, signal="SIGKILL")
        outcome = inside.run(fault)
        assert outcome.survived, (fault, outcome.problem)


@pytest.mark.parametrize(
    ("form", "moment", "signal"),
    [("RaceVecEnv", "step", "SIGKILL"), ("drawn by the game", "render", "SIGKILL")],
)
def test_so_it_is_with_the_forms_that_take_long_to_load(inside, form, moment, signal):
    target = "drawing" if form == "drawn by the game" else "race"
    fault = Fault(form=form, moment=moment, target=target, signal=signal, share=0.5, choice=0.0)
    outcome = inside.run(fault)
    assert outcome.survived, outcome.problem


@pytest.mark.parametrize("target", ["race", "fork server"])
def test_a_game_that_is_killed_in_the_midst_of_steps_is_hit_at_all(inside, target):
    """The harness itself: its blows land, and the form says so."""
    answers = []
    for number in range(2):
        fault = Fault(
            form="ParallelEnv",
            moment="step",
            target=target,
            signal="SIGKILL",
            share=0.2 + 0.1 * number,
            choice=0.0,
        )
        outcome = inside.run(fault)
        assert outcome.survived, outcome.problem
        assert outcome.injected
        answers.append(outcome.answer)
    assert "EngineCrashed" in answers


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
def test_a_program_that_is_hit_says_so_and_leaves_nothing(outside, program, target, signal):
    fault = Fault(
        form=program, moment=OUTSIDE[0], target=target, signal=signal, share=0.7, choice=0.0
    )
    outcome = outside.run(fault)
    assert outcome.survived, outcome.problem


def test_a_number_is_always_the_same_fault():
    faults = [fault_of(1, number) for number in range(300)]
    assert faults == [fault_of(1, number) for number in range(300)]
    assert {fault.form for fault in faults} == set(WEIGHTS) == {*FORMS, *PROGRAMS}
    assert faults != [fault_of(2, number) for number in range(300)]


def test_no_process_has_shared_memory_that_could_be_left(outside):
    """What is looked for in ``/dev/shm`` after each fault cannot be there: nobody makes any."""
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
