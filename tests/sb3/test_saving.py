"""Policies of Stable-Baselines3 saved as agent folders."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import torch
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize

from stkzoo.errors import ConfigError
from stkzoo.race import run_race
from stkzoo.sb3 import RaceVecEnv, save_agent


@pytest.fixture
def make():
    made = []

    def made_by(view, policy="MlpPolicy", wrap=lambda envs: envs, **options):
        made.append(RaceVecEnv(1, num_kart=1, track="olivermath", view=view))
        envs = wrap(made[-1])
        return PPO(policy, envs, n_steps=8, batch_size=8, seed=1, device="cpu", **options)

    yield made_by
    for envs in made:
        envs.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("view", "activation"),
    [("racing", torch.nn.Tanh), ("box_discrete", torch.nn.ReLU), ("box_continuous", torch.nn.Tanh)],
)
def test_the_agent_acts_as_the_policy_does(view, activation, make, tmp_path):
    model = make(view, policy_kwargs={"activation_fn": activation, "net_arch": [16, 16]})
    (tmp_path / "pystk_actor.py").write_text("# my work")
    with pytest.raises(ConfigError, match=r"pystk_actor.py is not from this function; move it"):
        save_agent(model, tmp_path, view=view, name="A name")
    assert [path.name for path in tmp_path.iterdir()] == ["pystk_actor.py"]
    for name in ("A name", "A 'quoted' name"):  # a saved agent can be replaced
        folder = save_agent(model, tmp_path / "agent", view=view, name=name)
    module = runpy.run_path(f"{folder}/pystk_actor.py")
    assert module["player_name"] == "A 'quoted' name"
    act = module["get_actor"](Path(folder), model.observation_space, model.action_space)
    random = np.random.default_rng(1)
    for observation in random.uniform(-1, 1, (20, *model.observation_space.shape)):
        seen = observation.astype(np.float32)
        expected, _ = model.predict(seen, deterministic=True)
        assert np.allclose(act(None, seen), expected, atol=1e-5)


@pytest.mark.slow
def test_the_agent_races(make, tmp_path):
    folder = save_agent(make("racing"), tmp_path / "agent", view="racing", name="Saved")
    result = run_race([folder, "ai"], track="olivermath", seed=1, max_steps=20)
    assert {row.driver for row in result.agents} == {"Saved", "ai"}
    assert not any(row.errors for row in result.agents)


@pytest.mark.slow
def test_an_unsupported_policy_is_refused(make, tmp_path):
    model = make("flattened_discrete", "MultiInputPolicy")
    with pytest.raises(ConfigError, match=r"MultiInput.*expected .MlpPolicy."):
        save_agent(model, tmp_path / "agent", view="flattened_discrete", name="Refused")


class Doubling(BaseFeaturesExtractor):
    """Features that differ from the observations."""

    def __init__(self, space):
        super().__init__(space, space.shape[0])

    def forward(self, observations):
        return 2 * observations


@pytest.mark.parametrize(
    ("view", "options"),
    [
        ("racing", {"policy_kwargs": {"features_extractor_class": Doubling}}),
        ("box_continuous", {"use_sde": True, "policy_kwargs": {"squash_output": True}}),
    ],
)
def test_a_policy_that_computes_more_than_its_layers_is_refused(view, options, make, tmp_path):
    with pytest.raises(ConfigError, match="without features_extractor_class and squash_output"):
        save_agent(make(view, **options), tmp_path / "agent", view=view, name="Refused")


def test_a_model_without_a_policy_network_is_refused(make, tmp_path):
    model = DQN("MlpPolicy", make("box_discrete").env, buffer_size=10, device="cpu")
    with pytest.raises(ConfigError, match=r"DQNPolicy.*expected .MlpPolicy."):
        save_agent(model, tmp_path / "agent", view="box_discrete", name="Refused")


def test_scaled_observations_are_refused_but_not_scaled_rewards(make, tmp_path):
    scaled = make("racing", wrap=VecNormalize)
    with pytest.raises(ConfigError, match=r"VecNormalize scaled.*norm_obs=False"):
        save_agent(scaled, tmp_path / "agent", view="racing", name="Refused")
    rewards = make("racing", wrap=lambda envs: VecNormalize(envs, norm_obs=False))
    save_agent(rewards, tmp_path / "agent", view="racing", name="Accepted")


@pytest.mark.parametrize(
    ("trained", "given", "options"),
    [
        ("racing", "box_discrete", {}),
        ("racing", "racing", {"wrap": lambda envs: VecFrameStack(envs, 2)}),
    ],
)
def test_a_view_with_other_observations_is_refused(trained, given, options, make, tmp_path):
    with pytest.raises(ConfigError, match="give the view in which it was trained"):
        save_agent(make(trained, **options), tmp_path / "agent", view=given, name="Refused")


def test_a_view_with_other_actions_is_refused(make, tmp_path):
    with pytest.raises(ConfigError, match="the model's actions are"):
        save_agent(make("box_discrete"), tmp_path / "agent", view="box_continuous", name="Refused")
