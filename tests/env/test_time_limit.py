"""The time limit of Gymnasium ids: ``max_cycles`` replaces it, ``max_episode_steps`` sets it."""

import pickle
from functools import partial

import gymnasium as gym
import pytest

from stkzoo import ConfigError
from stkzoo.env.ids import MAX_EPISODE_STEPS

IDS = ("supertuxkart/flattened_discrete-v0", "supertuxkart/multi-full-v0")
RACE = {"track": "lighthouse", "num_kart": 1}
LIMIT, LATER = 8, 12  # of the id in these tests, and the number of steps that they drive


@pytest.fixture(params=IDS)
def env_id(request, monkeypatch):
    assert gym.spec(request.param).max_episode_steps == MAX_EPISODE_STEPS == 1500
    monkeypatch.setattr(gym.spec(request.param), "max_episode_steps", LIMIT)
    return request.param


def length(env, **reset):
    """Returns the number of steps until the truncation; ``None`` if there is none."""
    env.reset(seed=1, **reset)
    for number in range(1, LATER + 1):
        if env.step(env.action_space.sample())[3]:
            return number
    return None


def of_reset(max_cycles):
    return {"options": {"max_cycles": max_cycles}}


def test_max_cycles_of_reset_replaces_the_limit_for_one_episode(env_id):
    with gym.make(env_id, **RACE) as env:
        assert env.spec.max_episode_steps == length(env) == LIMIT
        assert [length(env, **of_reset(limit)) for limit in (10, None, 5)] == [10, None, 5]
        assert length(env) == LIMIT
        specs = env.spec, pickle.loads(pickle.dumps(env.spec))
        copies = [pickle.loads(pickle.dumps(env)), *(gym.make(spec) for spec in specs)]
    for copy in copies:
        with copy:
            assert (length(copy, **of_reset(10)), length(copy)) == (10, LIMIT)


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ({"max_cycles": 10}, 10),
        ({"max_cycles": None}, None),
        ({"max_cycles": 5}, 5),
        ({"max_episode_steps": 10}, 10),
        ({"max_episode_steps": -1}, None),
        ({"max_episode_steps": 5, "max_cycles": 10}, 5),
    ],
    ids=str,
)
def test_limits_of_gym_make_hold_and_are_in_the_spec(env_id, limits, expected):
    with gym.make(env_id, **RACE, **limits) as env:
        assert env.spec.max_episode_steps == expected
        assert [length(env), length(env, **of_reset(11)), length(env)] == [expected, 11, expected]
        copy = gym.make(env.spec)
        with gym.make(env.spec) as late:
            late.reset(**of_reset(11))
            assert late.spec.max_episode_steps == expected
    with copy:
        assert (copy.spec.max_episode_steps, length(copy)) == (expected, expected)


def test_an_assigned_limit_holds_and_a_limit_around_a_bare_environment_stays(env_id):
    with gym.make(env_id, **RACE) as env:
        env.unwrapped.max_cycles = 10
        assert length(env) == 10
        with gym.wrappers.TimeLimit(pickle.loads(pickle.dumps(env.unwrapped)), 4) as bare:
            bare.unwrapped.spec = None
            assert length(bare, **of_reset(10)) == 4


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ({}, 1500),
        ({"max_cycles": 2000}, 2000),
        ({"max_cycles": None}, None),
        ({"max_episode_steps": 2000}, 2000),
        ({"max_episode_steps": 90, "max_cycles": 2000}, 90),
        ({"max_episode_steps": -1}, None),
    ],
    ids=str,
)
def test_make_vec_has_the_same_limits(limits, expected):
    make = partial(gym.make_vec, IDS[0], vectorization_mode="vector_entry_point")
    envs = make(**RACE, **limits)
    assert envs.races[0].max_cycles == expected
    envs.close()
    with pytest.raises(ConfigError, match=r"max_episode_steps is 0, expected a whole number"):
        make(max_episode_steps=0)


def test_max_cycles_of_reset_reaches_every_race_of_a_vector(monkeypatch):
    monkeypatch.setattr(gym.spec(IDS[0]), "max_episode_steps", LIMIT)
    for mode in ("sync", "vector_entry_point"):
        envs = gym.make_vec(IDS[0], num_envs=2, vectorization_mode=mode, **RACE)
        envs.reset(seed=1, options={"max_cycles": 10})
        ends = [envs.step(envs.action_space.sample())[3].tolist() for _ in range(10)]
        assert ends == [[False, False]] * 9 + [[True, True]]
        envs.close()
