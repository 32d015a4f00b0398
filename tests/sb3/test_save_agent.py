"""Policies of Stable-Baselines3 saved as agent folders."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from stkzoo.errors import ConfigError
from stkzoo.race import run_race
from stkzoo.sb3 import RaceVecEnv, save_agent


@pytest.fixture
def make():
    made = []

    def made_by(view, policy="MlpPolicy", **options):
        made.append(RaceVecEnv(1, num_kart=1, track="olivermath", view=view))
        return PPO(policy, made[-1], n_steps=8, batch_size=8, seed=1, device="cpu", **options)

    yield made_by
    for envs in made:
        envs.close()


@pytest.mark.parametrize(
    ("view", "activation"),
    [("racing", torch.nn.Tanh), ("box_discrete", torch.nn.ReLU), ("box_continuous", torch.nn.Tanh)],
)
def test_the_agent_acts_as_the_policy_does(view, activation, make, tmp_path):
    model = make(view, policy_kwargs={"activation_fn": activation, "net_arch": [16, 16]})
    folder = save_agent(model, tmp_path / "agent", view=view, name="A 'quoted' name")
    module = runpy.run_path(f"{folder}/pystk_actor.py")
    assert module["player_name"] == "A 'quoted' name"
    act = module["get_actor"](Path(folder), model.observation_space, model.action_space)
    random = np.random.default_rng(1)
    for observation in random.uniform(-1, 1, (20, *model.observation_space.shape)):
        seen = observation.astype(np.float32)
        expected, _ = model.predict(seen, deterministic=True)
        assert np.allclose(act(None, seen), expected, atol=1e-5)


def test_the_agent_races(make, tmp_path):
    folder = save_agent(make("racing"), tmp_path / "agent", view="racing", name="Saved")
    result = run_race([folder, "ai"], track="olivermath", seed=1, max_steps=20)
    assert {row.driver for row in result.agents} == {"Saved", "ai"}
    assert not any(row.errors for row in result.agents)


def test_an_unsupported_policy_is_refused(make, tmp_path):
    model = make("flattened_discrete", "MultiInputPolicy")
    with pytest.raises(ConfigError, match=r"MultiInput.*expected .MlpPolicy."):
        save_agent(model, tmp_path / "agent", view="flattened_discrete", name="Refused")


def test_a_misspelled_view_is_refused(make, tmp_path):
    with pytest.raises(ConfigError, match="Did you mean 'racing'"):
        save_agent(make("racing"), tmp_path / "agent", view="racign", name="Refused")
