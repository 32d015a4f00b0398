"""The planner in races, and its candidates."""

import contextlib

import numpy as np
import pytest

from stkzoo import race_v0
from stkzoo.agents.heuristic import create_state
from stkzoo.agents.planner import Candidate, Planner, PlannerSettings, base_policy
from stkzoo.agents.planner.copies import RaceCopy
from stkzoo.errors import ConfigError
from stkzoo.evaluation import DemoRecorder, DemoView, record_demonstrations
from stkzoo.race import run_race
from stkzoo.race.replay import recorded_driver

SMALL = PlannerSettings(num_candidates=3, num_finalists=2, final_steps=4)
#: Steps until the karts may drive, and steps after that.
GRID, SOME = 20, 40


def make(**options):
    return race_v0.parallel_env(agents=1, track="olivermath", **options)


def drive(env, act, steps, seed=2):
    """Drives at most ``steps`` steps; returns the actions and the distance."""
    observations, infos = env.reset(seed=seed)
    actions = []
    while env.agents and len(actions) < steps:
        actions.append(act(observations["kart_0"]))
        observations, _, _, _, infos = env.step({"kart_0": actions[-1]})
    return actions, infos["kart_0"]["distance"]


def plan(env, steps, settings=SMALL, **options):
    planner = Planner(settings, **options)
    return drive(env, lambda observation: planner.act(env, observation), steps)


@pytest.fixture
def env():
    with make(num_kart=1) as env:
        yield env


@pytest.mark.matrix
def test_drives_farther_than_its_base_policy(env):
    driver, choose = base_policy("pretrained:ace")
    _, base = drive(env, lambda observation: driver.drive(observation, choose), 120)
    _, planned = plan(env, 120, PlannerSettings())
    assert planned > base


def test_drives_like_its_base_policy_without_other_candidates(env):
    driver = create_state()
    base, _ = drive(env, driver.drive, GRID + SOME)
    alone = PlannerSettings(num_candidates=1, num_finalists=1)
    planned, _ = plan(env, GRID + SOME, alone, base="heuristic")
    assert planned == base


@pytest.mark.slow
def test_drives_the_same_race_with_the_same_seed(env):
    first, second, other = (plan(env, GRID + SOME, seed=seed) for seed in (3, 3, 4))
    assert first == second
    assert first[0] != other[0]


@pytest.mark.slow
def test_planning_does_not_change_the_race(env):
    actions, distance = plan(env, GRID + SOME)
    recorded = iter(actions)
    assert drive(env, lambda _: next(recorded), GRID + SOME) == (actions, distance)


def test_a_new_race_after_close_needs_new_copies(env):
    planner = Planner(SMALL)
    drive(env, lambda observation: planner.act(env, observation), GRID + 4)
    planner.close()
    _, distance = drive(env, lambda observation: planner.act(env, observation), GRID + 12)
    assert distance > 0


@pytest.fixture
def copy_of_long_race(env):
    """Returns a copy of a race whose reset overrides the environment's laps and step size."""
    observations, _ = env.reset(seed=1, options={"laps": 3, "step_size": 0.05})
    with contextlib.closing(RaceCopy(env.clone(), "kart_0")) as copied:
        copied.begin(env, create_state(), observations["kart_0"], Candidate())
        yield copied


def test_the_length_of_a_copy_counts_the_laps_of_its_race(env, copy_of_long_race):
    assert copy_of_long_race.length == 3 * env.track_map.length


@pytest.mark.parametrize("view", ["flattened_discrete", "racing"])
def test_refuses_an_observation_of_a_flattened_view(view):
    with race_v0.parallel_env(num_kart=2, agents=1, track="lighthouse", view=view) as env:
        observations, _ = env.reset(seed=0)
        with pytest.raises(ConfigError, match="another view than 'full' of agent 'kart_0'"):
            Planner().act(env, observations["kart_0"])


def test_refuses_an_environment_of_several_agents():
    with race_v0.parallel_env(agents=2, num_kart=2, track="olivermath") as env:
        observations, _ = env.reset(seed=1)
        with pytest.raises(ConfigError, match="plans for 2 agents"):
            Planner().act(env, observations["kart_0"])


# ---------------------------------------------------------------------- use as a driver


@pytest.mark.slow
def test_races_against_bots_as_a_driver():
    result = run_race(["planner", "ai"], track="olivermath", seed=1, max_steps=GRID + 12)
    distances = {row.driver: row.distance for row in result.agents}
    assert distances["planner"] > 0


def test_use_as_an_opponent_in_an_environment_logs_an_error(caplog):
    env = race_v0.parallel_env(agents=1, num_kart=2, track="olivermath", opponents=["planner"])
    with env:
        env.reset(seed=1)
    assert "races of its own" in caplog.text


@pytest.mark.slow
def test_its_demonstrations_are_repeatable(tmp_path):
    demos = record_demonstrations(
        "planner",
        output=tmp_path / "demos.safetensors",
        tracks="olivermath",
        karts=1,
        max_steps=GRID + 12,
        jobs=1,
    )
    recorder, again = DemoRecorder(1, DemoView("racing")), demos[0].controls
    how = {"track": "olivermath", "seed": 0, "max_steps": GRID + 12}
    run_race([recorded_driver("again", again)], listeners=[recorder], **how)
    columns = recorder.episodes(demos.plan).columns
    np.testing.assert_array_equal(columns["observations"], demos.columns["observations"])


# ---------------------------------------------------------------------- the base policy


def test_refuses_an_unknown_base_driver(tmp_path):
    with pytest.raises(ConfigError, match=r"card\.json"):
        base_policy(tmp_path)


# ---------------------------------------------------------------------- candidates


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"horizon": 3}, "horizon"),
        ({"num_finalists": 13}, "num_finalists"),
        ({"holds": ()}, "holds"),
    ],
)
def test_settings_are_checked(change, message):
    with pytest.raises(ConfigError, match=message):
        PlannerSettings(**change)
