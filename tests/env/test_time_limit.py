"""The time limit of Gymnasium ids and ``max_cycles``: the smaller one holds."""

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


def length(env, **options):
    """Returns the number of steps until the truncation; ``None`` if there is none."""
    env.reset(seed=1, options=options)
    for number in range(1, LATER + 1):
        if env.step(env.action_space.sample())[3]:
            return number
    return None


def test_the_smaller_limit_holds(env_id):
    with gym.make(env_id, **RACE) as env:
        assert env.spec.max_episode_steps == LIMIT
        lengths = [length(env, **own) for own in ({}, {"max_cycles": 5}, {"max_cycles": None})]
        assert lengths == [LIMIT, 5, LIMIT]
        with pytest.warns(UserWarning, match="after 8 steps unless you pass max_episode_steps=10"):
            assert length(env, max_cycles=10) == LIMIT
        again = pickle.loads(pickle.dumps(env))
    with again, gym.make(again.spec, max_cycles=5) as short:
        assert [length(again), length(short)] == [LIMIT, 5]


def test_max_episode_steps_of_gym_make_replaces_the_limit_of_the_id(env_id):
    with gym.make(env_id, max_episode_steps=10, **RACE) as env, gym.make(env.spec) as again:
        assert [length(env), length(again)] == [10, 10]
    with gym.make(env_id, max_episode_steps=-1, **RACE) as env:
        assert [length(env), length(env, max_cycles=5)] == [None, 5]


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ({}, 1500),
        ({"max_cycles": 90}, 90),
        ({"max_cycles": None}, 1500),
        ({"max_episode_steps": 2000}, 2000),
        ({"max_episode_steps": 2000, "max_cycles": 1800}, 1800),
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
    with pytest.warns(UserWarning, match="max_cycles is 2000, but gym.make truncates"):
        make(**RACE, max_cycles=2000).close()


def test_max_cycles_of_reset_reaches_every_race_of_a_vector():
    for mode in ("sync", "vector_entry_point"):
        envs = gym.make_vec(IDS[0], num_envs=2, vectorization_mode=mode, **RACE)
        envs.reset(seed=1, options={"max_cycles": 10})
        ends = [envs.step(envs.action_space.sample())[3].tolist() for _ in range(10)]
        assert ends == [[False, False]] * 9 + [[True, True]]
        envs.close()
