"""Stable-Baselines3 with many races at once; one policy controls all agents."""

from __future__ import annotations

import os
import signal

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecNormalize

from stkzoo import AgentSpec, ConfigError, RaceVectorEnv
from stkzoo.sb3 import ActiveDictRolloutBuffer, RaceVecEnv
from tests.support.playing import vector_maker

OPTIONS = {"num_kart": 3, "agents": 2, "track": "olivermath", "max_cycles": 30}
LEARNING = {"n_steps": 32, "batch_size": 32, "n_epochs": 1, "device": "cpu", "seed": 1}
BOTS = {"num_kart": 2, "agents": [AgentSpec(use_ai=True)] * 2, "track": "olivermath"}


@pytest.fixture
def make():
    """Makes environments, and closes them after the test."""
    with vector_maker(RaceVecEnv, **OPTIONS) as make:
        yield make


def same(one, other):
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    return np.asarray(one).tobytes() == np.asarray(other).tobytes()


def weights(model):
    return {name: value.clone() for name, value in model.policy.state_dict().items()}


def changed(before, model):
    return any((before[name] != value).any() for name, value in model.policy.state_dict().items())


@pytest.mark.slow
def test_ppo_learns_from_normalized_races_although_one_crashes(make):
    envs = make()
    normalized = VecNormalize(envs, norm_obs_keys=["continuous"])
    model = PPO(
        "MultiInputPolicy", normalized, rollout_buffer_class=ActiveDictRolloutBuffer, **LEARNING
    )
    model.learn(128)
    assert {episode["l"] for episode in model.ep_info_buffer} == {30}
    os.kill(envs.races.races[0].live_race.session.pid, signal.SIGKILL)
    before = weights(model)
    model.learn(128, reset_num_timesteps=False)
    assert changed(before, model)
    assert envs.num_crashes == 1


@pytest.mark.slow
def test_it_returns_the_same_as_the_gymnasium_vector(make):
    envs, races = make(), RaceVectorEnv(2, **OPTIONS)
    envs.seed(7)
    assert same(envs.reset(), races.reset(seed=7)[0])
    for _ in range(35):
        actions = races.action_space.sample()
        observations, rewards, done, _ = envs.step(actions)
        expected = races.step(actions)
        assert same(observations, expected[0])
        assert same(rewards, expected[1].astype(np.float32))
        assert same(done, expected[2] | expected[3])
    races.close()


@pytest.mark.slow
def test_infos_describe_the_end_of_an_episode(make):
    envs = make()
    envs.reset()
    returns = np.zeros(4)
    for _ in range(30):
        _, rewards, done, infos = envs.step(np.full(4, 700))
        returns += rewards
    assert done.all()
    for info, value in zip(infos, returns, strict=True):
        assert info["TimeLimit.truncated"]
        assert info["terminal_observation"] in envs.observation_space
        assert info["episode"]["r"] == pytest.approx(value, abs=1e-4)
        assert info["episode"]["l"] == 30
        assert info["episode"]["t"] > 0
    assert [info["episode/length"] for info in envs.reset_infos] == [0] * 4


@pytest.mark.slow
def test_an_agent_that_finishes_is_done_and_then_has_empty_episodes():
    envs = RaceVecEnv(1, **BOTS)
    envs.seed(2)
    envs.reset()
    done = np.zeros(2, bool)
    while not done.any():
        _, _, done, infos = envs.step(np.zeros(envs.num_envs, np.int64))
    first = int(np.argmax(done))
    assert not infos[first]["TimeLimit.truncated"]
    assert infos[first]["active"]
    assert infos[first]["finish_time"] > 0
    assert infos[first]["terminal_observation"]["continuous"].any()
    observations, rewards, is_over, infos = envs.step(np.zeros(envs.num_envs, np.int64))
    assert is_over.tolist() == done.tolist()
    assert rewards[first] == 0
    assert not observations["continuous"][first].any()
    assert infos[first].keys() == {"active", "terminal_observation", "TimeLimit.truncated", "track"}
    assert not infos[first]["active"]
    assert infos[1 - first]["active"]
    envs.close()


def test_each_slot_has_the_seed_of_its_race(make):
    envs = make()
    assert envs.seed(4) == [4, 4, 5, 5]


def test_a_seed_applies_to_one_reset(make):
    envs = make()
    envs.seed(4)
    first = envs.reset()
    assert not same(first, envs.reset())


@pytest.mark.slow
def test_options_of_the_races_persist_and_infos_name_the_track(make):
    envs = make(num_races=1, max_cycles=2)
    envs.reset()
    envs.races.set_options({"track": "zengarden"})
    tracks = []
    for _ in range(4):
        *_, infos = envs.step(np.zeros((envs.num_envs, *envs.action_space.shape), np.int64))
        tracks.append(infos[0]["track"])
    assert tracks == ["olivermath", "olivermath", "zengarden", "zengarden"]
    assert envs.reset_infos[0]["track"] == "zengarden"


def test_different_options_in_one_race_are_refused(make):
    envs = make()
    envs.set_options([{"track": "zengarden"}, {}, {}, {}])
    with pytest.raises(ConfigError, match="slots 0 and 1 differ"):
        envs.reset()
    envs.set_options([{"track": "zengarden"}] * 2 + [{}] * 2)
    envs.reset()
    tracks = [race.track for race in envs.get_attr("race")]
    assert tracks == ["zengarden"] * 2 + ["olivermath"] * 2


def test_attributes_are_those_of_the_races(make):
    envs = make()
    envs.set_attr("max_cycles", 7, indices=[2, 3])
    assert envs.get_attr("max_cycles") == [30, 30, 7, 7]
    assert envs.get_attr("max_cycles", indices=3) == [7]
    assert not envs.has_attr("no_such_thing")


def test_a_method_is_called_once_for_each_race(make):
    envs = make()
    calls = []
    for number, race in enumerate(envs.races.races):
        race.note = lambda word, number=number: calls.append((number, word)) or number
    assert envs.env_method("note", "hello") == [0, 0, 1, 1]
    assert calls == [(0, "hello"), (1, "hello")]


def test_it_counts_as_monitored_and_not_otherwise_wrapped(make):
    envs = make()
    assert envs.env_is_wrapped(Monitor) == [True] * 4
    assert envs.env_is_wrapped(gym.wrappers.TimeLimit, indices=[0]) == [False]


@pytest.mark.parametrize("view", ["simple", "flattened"])
def test_a_view_with_dict_actions_is_refused(make, view):
    with pytest.raises(ConfigError, match="flattened_discrete"):
        make(view=view)


@pytest.mark.slow
def test_idle_steps_of_races_are_not_learned_from():
    envs = RaceVecEnv(1, **BOTS)
    learning = {**LEARNING, "n_steps": 340, "batch_size": 680}
    model = PPO("MultiInputPolicy", envs, rollout_buffer_class=ActiveDictRolloutBuffer, **learning)
    active = []
    model.learn(
        680,
        callback=lambda local, _: active.extend(info["active"] for info in local["infos"]) or True,
    )
    (batch,) = model.rollout_buffer.get()
    assert 0 < len(batch.actions) == sum(active) < 680
    assert batch.observations["continuous"].any(dim=1).all()
    envs.close()


def test_the_info_of_a_slot_is_a_dict_of_python_values(make):
    envs = make(max_cycles=3)
    envs.reset()
    info = envs.step(np.full(4, 700))[3][3]
    assert type(info) is dict
    assert (info["episode/length"], info["track"], info["active"]) == (1, "olivermath", True)
    assert type(info["position"]) is int
    assert type(info["distance"]) is float
    assert "terminal_observation" not in info
    before = info.copy()
    envs.step(np.full(4, 700))
    assert info == before
