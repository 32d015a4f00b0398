"""All ids pass the checkers of Gymnasium and Stable-Baselines3; vectors, specs and copies work."""

from __future__ import annotations

import copy
from contextlib import nullcontext

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import stkzoo
from stkzoo import (
    ActionError,
    AgentSpec,
    ApiOrderError,
    CameraMode,
    ConfigError,
    make_stkrace_vec,
    race_v0,
)
from stkzoo.env.gymnasium_api import STKRaceEnv
from tests.support.playing import fingerprint
from tests.support.views import EACH_ID

IDS = [*EACH_ID, "supertuxkart/multi-full-v0"]
# Stable-Baselines3 does not support Dict action spaces.
DISCRETE = "supertuxkart/flattened_discrete-v0"
SB3_IDS = [
    pytest.param("supertuxkart/flattened_continuous_actions-v0", marks=pytest.mark.matrix),
    pytest.param("supertuxkart/flattened_multidiscrete-v0", marks=pytest.mark.matrix),
    DISCRETE,
]
# Distances and speeds have no natural bounds.
UNBOUNDED = "ignore:.*A Box observation space (minimum|maximum) value is -?infinity:UserWarning"
# Acceleration ranges from 0 to 1; braking is a separate control.
ASYMMETRIC = "ignore:.*recommend.*symmetric and normalized:UserWarning"
OPTIONS = {"track": "olivermath", "num_kart": 3}


def race(env, steps=30, seed=7):
    """Returns fingerprints of a few steps with seeded random actions."""
    observation, info = env.reset(seed=seed)
    prints = [fingerprint([observation, info])]
    space = copy.deepcopy(env.action_space)
    space.seed(1)
    prints.extend(fingerprint(env.step(space.sample())) for _ in range(steps))
    return prints


@pytest.mark.slow
@pytest.mark.filterwarnings(UNBOUNDED, ASYMMETRIC)
@pytest.mark.parametrize("env_id", IDS)
def test_check_env_passes_without_other_warnings(env_id):
    with gym.make(env_id, **OPTIONS) as env:
        # test_render.py runs the check with rendering.
        check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.filterwarnings(ASYMMETRIC)
@pytest.mark.parametrize("env_id", SB3_IDS)
def test_sb3_check_env_passes_without_other_warnings(env_id):
    with gym.make(env_id, **OPTIONS) as env:
        sb3_check_env(env)


def test_seeds_and_the_random_generator_of_an_id_are_those_of_the_race():
    with STKRaceEnv(**OPTIONS) as env:
        for seed in (-1, 1.5):
            with pytest.raises(ConfigError, match=f"seed is {seed}"):
                env.reset(seed=seed)
        for seed in (np.int64(3), None):
            env.reset(seed=seed)
            assert env.np_random_seed == 3
            assert env.np_random is env.core.np_random


@pytest.mark.parametrize(
    ("env_id", "agents"),
    [
        ("simple-v0", {"agent": AgentSpec(name="A", rank_start=1, camera_mode=CameraMode.ON)}),
        ("multi-full-v0", {"agents": [AgentSpec(kart="gnu"), AgentSpec(use_ai=True)]}),
    ],
)
def test_a_spec_restored_from_json_keeps_its_agents(env_id, agents):
    with gym.make(f"supertuxkart/{env_id}", **agents, **OPTIONS) as env:
        text = env.spec.to_json()
        with gym.make(EnvSpec.from_json(text)) as again:
            assert again.unwrapped.core.specs == env.unwrapped.core.specs
            assert race(again, 3) == race(env, 3)


@pytest.mark.parametrize(
    ("name", "value", "read"),
    [
        ("default_track", "hacienda", lambda env: env.current_track),
        ("laps", 2, lambda env: env.core.race.laps),
        ("max_paths", 3, lambda env: len(env.core.observe([0])["kart_0"]["paths_width"])),
        ("step_size", 0.05, lambda env: env.core.step_size),
    ],
)
def test_options_of_later_races_can_be_set_as_attributes(name, value, read):
    with STKRaceEnv(**OPTIONS) as env:
        env.reset(seed=1)
        setattr(env, name, value)
        assert read(env) != value  # the race continues unchanged
        env.reset(seed=1)
        assert getattr(env, name) == read(env) == value
        with pytest.raises(ConfigError):
            setattr(env, name, -1)


def test_the_dict_of_agents_refuses_wrappers_that_finished_agents_would_not_have():
    with pytest.raises(ConfigError, match="Put them into MonoAgentWrapperAdapter"):
        stkzoo.STKRaceMultiEnv(**OPTIONS, view={0: gym.Wrapper})


@pytest.mark.parametrize("env_id", ["supertuxkart/full-v0", "supertuxkart/multi-full-v0"])
def test_a_step_after_the_end_returns_the_last_values_without_reward_and_warns_once(env_id):
    agents = {"agents": 2} if "multi" in env_id else {}
    with gym.make(env_id, max_cycles=2, **agents, **OPTIONS) as env:
        for seed in range(2):
            env.reset(seed=seed)
            action = env.action_space.sample()
            env.step(action)
            last, _, *ends, info = env.step(action)
            assert ends == [False, True]
            with pytest.warns(UserWarning, match="call reset") if seed == 0 else nullcontext():
                again, reward, *ends_again, info_again = env.step(action)
            assert (reward, ends_again) == (0.0, ends)
            if "reward" in info:
                info["reward"] = dict.fromkeys(info["reward"], 0.0)
            assert fingerprint([again, info_again]) == fingerprint([last, info])
            assert again is not last
        with pytest.raises(ApiOrderError, match=r"call reset\(\) first"):
            env.unwrapped.clone().step(action)


def test_the_default_kart_replaces_an_unknown_one_with_one_warning_for_each_name():
    agents = [AgentSpec(kart="Team 1/\N{LATIN SMALL LETTER E WITH ACUTE}"), {"kart": None}]
    with pytest.warns(UserWarning, match="unknown kart 'Team 1/.'.* default kart races"):
        env = gym.make("supertuxkart/multi-full-v0", agents=agents, **OPTIONS)
    env.reset(seed=1)
    agents[0].kart = "gnu"
    env.reset(seed=1)
    assert sorted(env.unwrapped.race.kart_types) == ["gnu", "tux", "tux"]
    agents[0].kart = "gnuu"
    with pytest.warns(UserWarning, match="Did you mean 'gnu'"):
        env.reset(seed=1)
    assert set(env.unwrapped.race.kart_types) == {"tux"}
    env.close()
    with pytest.warns(UserWarning, match="unknown kart 'Team'"):
        gym.make_vec(DISCRETE, num_envs=1, agent=AgentSpec(kart="Team"), **OPTIONS).close()


def test_an_agent_can_be_a_mapping_as_in_yaml():
    fields = {"name": "Ann", "camera_mode": "ON", "rank_start": 0}
    with race_v0.parallel_env(agents=[fields, {}], **OPTIONS) as env:
        env.reset(seed=1)
        assert env.unwrapped.specs == [AgentSpec(**fields), AgentSpec()]
        assert env.unwrapped.race.kart_indices[0] == 0
    assert stkzoo.STKRaceEnv(agent=fields).agent == AgentSpec(**fields)
    with pytest.raises(ConfigError, match=r"unknown field 'nam' of agent 1. Did you mean 'name'"):
        race_v0.parallel_env(agents=[{}, {"nam": "Ann"}])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")  # Gymnasium logs the traceback as one
def test_an_invalid_action_in_a_worker_process_is_an_action_error():
    envs = make_stkrace_vec(2, "supertuxkart/flattened_discrete-v0", env_kwargs=OPTIONS)
    envs.reset(seed=3)
    with pytest.raises(ActionError, match=r"action of agent 'kart_0' is .*100000"):
        envs.step(np.array([0, 100_000]))
    envs.close(terminate=True)


@pytest.mark.slow
def test_make_stkrace_vec_drives_two_races_at_once():
    envs = make_stkrace_vec(2, "supertuxkart/full-v0", env_kwargs=OPTIONS)
    observations, _ = envs.reset(seed=3)
    for _ in range(5):
        observations, rewards, *_ = envs.step(envs.action_space.sample())
    assert observations in envs.observation_space
    assert rewards.shape == (2,)
    envs.close()
