"""Options of views, in all places where a view can be chosen."""

from __future__ import annotations

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

import stkzoo
from stkzoo import ConfigError, MonoAgentWrapperAdapter, race_v0

RACE = {"num_kart": 2, "track": "lighthouse"}
OPTIONS = {"state_items": 2, "steer_steps": 3}
VIEW = ("flattened_discrete", OPTIONS)
ID = "supertuxkart/flattened_discrete-v0"


def first(env):
    """Returns the first agent's first observation and its number of actions."""
    with env:
        observation, _ = env.reset(seed=3)
        observation = observation.get("kart_0", observation)
        space = env.action_space("kart_0") if callable(env.action_space) else env.action_space
        return observation["continuous"], space.n


@pytest.fixture(scope="module")
def expected():
    return first(race_v0.parallel_env(**RACE, agents=1, view=VIEW))


def same(ours, expected, tolerance=0.0):
    assert ours[1] == expected[1] == 480
    assert ours[0].shape == (83,)
    np.testing.assert_allclose(ours[0], expected[0], rtol=tolerance, atol=10 * tolerance)


def test_an_id_accepts_the_options_of_its_view_as_keywords(expected):
    with gym.make(ID, **RACE, **OPTIONS) as env:
        copies = pickle.loads(pickle.dumps(env)), gym.make(EnvSpec.from_json(env.spec.to_json()))
        assert env.unwrapped.get_keys_to_action()[""] in env.action_space
        for each in (env, *copies):
            same(first(each), expected)


def test_the_adapter_with_named_views_survives_json():
    base = gym.make("supertuxkart/multi-full-v0", **RACE)
    env = MonoAgentWrapperAdapter(base, {"0": VIEW, "1": "simple"})
    with env, gym.make(EnvSpec.from_json(env.spec.to_json())) as again:
        assert again.observation_space == env.observation_space
        assert again.action_space["0"].n == 480


@pytest.mark.parametrize(
    "make",
    [
        lambda: stkzoo.RaceVectorEnv(1, **RACE, agents=1, view=VIEW),
        lambda: gym.make_vec(
            ID, num_envs=1, vectorization_mode="vector_entry_point", **RACE, **OPTIONS
        ),
    ],
)
def test_vector_environments_accept_view_options(make, expected):
    envs = make()
    observations, _ = envs.reset(seed=3)
    same((observations["continuous"][0], envs.single_action_space.n), expected)
    envs.close()


def test_a_keyword_of_both_the_race_and_its_view_reaches_both():
    with gym.make("supertuxkart/control-v0", **RACE, step_size=0.05) as env:
        chain = env.unwrapped.core.live_race.chains
        assert chain._plans["kart_0"].car.step_size == 0.05
        assert env.unwrapped.core.options.step_size == 0.05


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
@pytest.mark.parametrize(
    ("env_id", "keywords", "message"),
    [
        (
            "simple-v0",
            {"state_itmes": 3},
            "unexpected keyword argument 'state_itmes'.*'state_items'",
        ),
        ("simple-v0", {"steer_steps": 3}, "unexpected keyword argument 'steer_steps'"),
        ("simple-v0", {"agents": 2}, "unexpected keyword argument 'agents'. Did you mean 'agent'"),
        ("simple-v0", {"state_items": "5"}, "state_items is '5', expected a whole number"),
        ("multi-full-v0", {"state_items": 5}, "unexpected keyword argument 'state_items'"),
    ],
)
def test_an_error_for_an_unknown_option_suggests_the_right_one(make, env_id, keywords, message):
    with pytest.raises(ConfigError, match=message) as caught:
        make(f"supertuxkart/{env_id}", **keywords)
    assert len(str(caught.value).splitlines()[0]) <= 200
