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
@pytest.mark.parametrize("track", ["olivermath", "minigolf", "zengarden"])
def test_finishes_alone(track):
    assert run_race(["heuristic"], track=track, seed=5).is_finished


@pytest.mark.slow
def test_finishes_a_reversed_track():
    assert run_race(["heuristic"], track="lighthouse", reverse=True, seed=5).is_finished


@pytest.mark.slow
def test_is_on_average_faster_than_the_median_bot():
    results = races()
    assert statistics.mean(times(results, "heuristic")) < statistics.median(times(results, "ai"))


@pytest.mark.slow
def test_acts_within_its_space_on_every_step():
    with race_v0.parallel_env(num_kart=2, track="minigolf", max_cycles=None) as env:
        observations, _ = env.reset(seed=4)
        agents = list(env.agents)
        actors = {
            agent: heuristic.get_actor(None, env.observation_space(agent), env.action_space(agent))
            for agent in agents
        }
        states = {agent: heuristic.create_state() for agent in agents}
        while env.agents:
            actions = {a: actors[a](states[a], observations[a]) for a in env.agents}
            assert all(action in env.action_space(a) for a, action in actions.items())
            observations, *_ = env.step(actions)
    assert agents == ["kart_0", "kart_1"]


def test_does_not_change_the_observation():
    with race_v0.parallel_env(agents=[AgentSpec()], num_kart=3, track="xr591") as env:
        observation = env.reset(seed=0)[0]["kart_0"]
        before = copy.deepcopy(observation)
        heuristic.create_state().drive({**observation, "phase": 3})
        assert data_equivalence(observation, before)


def on_the_grid():
    """Returns a kart's first observation in a race."""
    with race_v0.parallel_env(num_kart=1, track="lighthouse") as env:
        return env.reset(seed=0)[0]["kart_0"]


def what_a_held_kart_does(speed=0.0, **rules):
    """Returns ``go``, ``brake`` or ``rescue`` for each step of a kart that cannot move."""
    observation = on_the_grid()
    held = {**observation, "phase": 3, "velocity": np.array([0, 0, speed], np.float32)}
    driver = heuristic.create_state(DriverParameters(**rules))
    actions = [driver.drive(held) for _ in range(60)]
    return ["rescue" if a["rescue"] else "brake" if a["brake"] else "go" for a in actions]


def test_calls_rescue_when_stuck_and_waits_for_it():
    done = what_a_held_kart_does()
    calls = [step for step, what in enumerate(done) if what == "rescue"]
    assert calls[0] == pytest.approx(DriverParameters().stuck_time / STEP, abs=1)
    assert min(later - call for call, later in itertools.pairwise(calls)) >= RESCUE_STEPS
    order = [what for what, _ in itertools.groupby(done)]
    assert order[:5] == ["go", "rescue", "go", "brake", "rescue"]  # the first rescue did not help


def test_brakes_for_a_bend_unless_it_would_drive_backwards():
    observation = on_the_grid()
    cosine, sine = np.cos(1.0), np.sin(1.0)  # the road is to the right and points away
    turned = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]], np.float32)
    sharp = {
        **observation,
        "phase": 3,
        "max_steer_angle": np.array([0.05], np.float32),
        **{
            key: [turned @ (point + np.array([4, 0, 0], np.float32)) for point in observation[key]]
            for key in ("paths_start", "paths_end")
        },
    }
    brakes = []
    for speed in np.array([-1, 1]) + DriverParameters().brake_speed:
        moving = {**sharp, "velocity": np.array([0, 0, speed], np.float32)}
        brakes.append(heuristic.create_state().drive(moving)["brake"])
    assert brakes == [0, 1]
