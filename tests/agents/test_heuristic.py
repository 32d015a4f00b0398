"""The heuristic driver in real races."""

import copy
import itertools
import statistics

import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

from stkzoo import AgentSpec, race_v0
from stkzoo.agents import heuristic
from stkzoo.agents.planning.motion import RESCUE_STEPS, STEP
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.race import run_race

SEEDS = range(1, 7)


def races():
    drivers = ["heuristic", "ai", "ai", "ai"]
    return [run_race(drivers, track="lighthouse", seed=seed) for seed in SEEDS]


def times(results, driver):
    return [row.finish_time for result in results for row in result.agents if row.driver == driver]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("track", "reverse"), [("olivermath", False), ("zengarden", False), ("lighthouse", True)]
)
def test_finishes_alone(track, reverse):
    assert run_race(["heuristic"], track=track, reverse=reverse, seed=5).is_finished


@pytest.mark.matrix
def test_is_on_average_faster_than_the_median_bot():
    results = races()
    assert statistics.mean(times(results, "heuristic")) < statistics.median(times(results, "ai"))


def test_does_not_change_the_observation():
    with race_v0.parallel_env(agents=[AgentSpec()], num_kart=3, track="xr591") as env:
        observation = env.reset(seed=0)[0]["kart_0"]
        before = copy.deepcopy(observation)
        heuristic.create_state().drive({**observation, "phase": 3})
        assert data_equivalence(observation, before)


def what_a_held_kart_does():
    """Returns ``go``, ``brake`` or ``rescue`` for each step of a kart that cannot move."""
    with race_v0.parallel_env(num_kart=1, track="lighthouse") as env:
        observation = env.reset(seed=0)[0]["kart_0"]
    held = {**observation, "phase": 3, "velocity": np.zeros(3, np.float32)}
    driver = heuristic.create_state()
    actions = [driver.drive(held) for _ in range(60)]
    return ["rescue" if a["rescue"] else "brake" if a["brake"] else "go" for a in actions]


def test_calls_rescue_when_stuck_and_waits_for_it():
    done = what_a_held_kart_does()
    calls = [step for step, what in enumerate(done) if what == "rescue"]
    assert calls[0] == pytest.approx(DriverParameters().stuck_time / STEP, abs=1)
    assert min(later - call for call, later in itertools.pairwise(calls)) >= RESCUE_STEPS
    order = [what for what, _ in itertools.groupby(done)]
    assert order[:5] == ["go", "rescue", "go", "brake", "rescue"]  # the first rescue did not help
