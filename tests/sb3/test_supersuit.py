"""Stable-Baselines3 learns from single-agent ids, and from whole races through SuperSuit."""

from __future__ import annotations

import gymnasium as gym
import pytest
import supersuit
from gymnasium.wrappers import FlattenObservation
from stable_baselines3 import PPO

from stkzoo import race_v0
from stkzoo.views import VIEWS
from tests.sb3.test_vec import changed, weights

OPTIONS = {"track": "olivermath", "num_kart": 3}
LEARNING = {"n_steps": 64, "batch_size": 32, "n_epochs": 1, "device": "cpu", "seed": 1}


def box_view(env):
    """A view with Box observations, which SuperSuit needs, and Box actions."""
    return FlatActions(FlattenObservation(VIEWS["flattened_continuous_actions"](env)))


class FlatActions(gym.ActionWrapper):
    """Flattens a Dict of continuous actions to one Box."""

    def __init__(self, env):
        super().__init__(env)
        self.action_space = gym.spaces.flatten_space(env.action_space)

    def action(self, action):
        return gym.spaces.unflatten(self.env.action_space, action)


def discrete_box_view(env):
    return FlattenObservation(VIEWS["flattened_discrete"](env))


@pytest.mark.slow
def test_ppo_learns_from_a_single_id():
    with gym.make("supertuxkart/flattened_multidiscrete-v0", **OPTIONS) as env:
        model = PPO("MultiInputPolicy", env, **LEARNING)
        before = weights(model)
        model.learn(256)
        assert changed(before, model)
        assert model.num_timesteps == 256


@pytest.mark.slow
@pytest.mark.parametrize(("view", "num_cpus"), [(box_view, 0), (discrete_box_view, 2)])
def test_ppo_learns_by_self_play_through_supersuit(view, num_cpus):
    env = race_v0.parallel_env(num_kart=3, track="olivermath", max_cycles=50, view=view)
    env = supersuit.black_death_v3(env)
    env = supersuit.pettingzoo_env_to_vec_env_v1(env)
    envs = supersuit.concat_vec_envs_v1(env, 2, num_cpus=num_cpus, base_class="stable_baselines3")
    model = PPO("MlpPolicy", envs, **{**LEARNING, "seed": None})
    before = weights(model)
    model.learn(6 * 64)
    assert envs.num_envs == 6
    assert changed(before, model)
    envs.close()
