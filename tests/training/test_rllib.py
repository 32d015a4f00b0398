"""The RLlib script, without training.

Ray needs an older Gymnasium than the tests; ``python -m benchmarks.ecosystem`` trains with it.
"""

import importlib.util
import os
import signal
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from stkzoo import RaceVectorEnv, Start
from stkzoo._installation import install_command
from stkzoo.agents.pretrained.mlp import MlpDriver
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.agents.training.rllib import selfplay
from stkzoo.agents.training.rllib.races import (
    MAIN,
    RaceSampler,
    RLlibArguments,
    make_races,
    sb3_names,
)
from stkzoo.agents.training.rllib.selfplay import main
from stkzoo.wrappers.racing import CHOICES, SIZE
from tests.support.networks import small_network

POLICIES = RLlibArguments(learners=2, frozen=2, slots=3)


def test_the_first_karts_learn_and_past_versions_drive_the_others():
    assert POLICIES.modules == [MAIN, "past_0", "past_1", "past_2"]
    assert POLICIES.modules_of(0) == [MAIN, MAIN, "past_0", "past_1"]
    assert POLICIES.modules_of(2) == [MAIN, MAIN, "past_2", "past_0"]


def test_a_new_snapshot_replaces_the_oldest_one():
    assert [POLICIES.slot(number) for number in range(5)] == [
        *("past_0", "past_1", "past_2"),
        *("past_0", "past_1"),
    ]


RACES = RLlibArguments(
    tracks=("lighthouse",), learners=2, frozen=1, bots=2, max_cycles=7, envs_per_runner=2
)


def sampler_of(races, arguments, likes=()):
    """Returns a sampler whose networks prefer some choices."""
    sampler = RaceSampler(races, arguments, seed=1)
    network = MlpDriver(small_network(likes, inputs=SIZE))
    sampler.load(dict.fromkeys(arguments.modules, network))
    return sampler


def test_the_steps_of_the_learners_karts_are_recorded_to_the_end_of_their_races():
    with closing(make_races(RACES)) as races:
        assert races.races[0].options.num_kart == 5
        sampler = sampler_of(races, RACES, likes=[2])
        first, second = sampler.sample(16), sampler.sample(16)
    assert [fragment.slot for fragment in first] == [0, 1, 3, 4]
    assert all(len(fragment) == 4 and not fragment.is_truncated for fragment in first)
    last, following = second[:2]  # those of the first kart
    assert (len(last), last.is_truncated, last.is_terminated) == (3, True, False)
    assert (last.observations[0] == first[0].observations[-1]).all()
    assert (following.slot, len(following)) == (0, 1)
    assert (last.observations[-1] != following.observations[0]).any()
    assert len(sampler.returns) == 4
    assert sampler.returns[0] == pytest.approx(
        np.concatenate([first[0].rewards, last.rewards]).sum()
    )
    assert (last.actions[:, 0] == 2).all()
    expected = np.zeros(len(last))
    for choice, logits in enumerate(np.split(last.logits, np.cumsum(CHOICES)[:-1], axis=1)):
        odds = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
        expected += np.log(odds[np.arange(len(odds)), last.actions[:, choice]])
    np.testing.assert_allclose(last.log_probabilities, expected, rtol=1e-5)


@pytest.mark.slow
def test_a_kart_that_finishes_is_terminated():
    near_finish = {"start": Start(share=0.97, speed=15.0), "track": "lighthouse"}
    straight = [10, *np.cumsum(CHOICES[:-1])]  # at full throttle
    with closing(RaceVectorEnv(1, num_kart=1, view="racing", **near_finish)) as races:
        sampler = sampler_of(races, RLlibArguments(learners=1, frozen=0, bots=0), straight)
        fragment, *_ = sampler.sample(100)
    assert (fragment.is_terminated, fragment.is_truncated) == (True, False)


@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
def test_a_race_that_crashes_is_truncated():
    with closing(make_races(RACES)) as races:
        sampler = sampler_of(races, RACES)
        sampler.sample(8)
        os.kill(races.races[0].live_race.session.pid, signal.SIGKILL)
        fragments = sampler.sample(24)
    assert [f.is_truncated for f in fragments if f.slot == 0] == [True, False]


def test_learned_weights_have_the_names_of_stable_baselines3():
    shapes = {
        "encoder.actor_encoder.net.mlp.0": (8, SIZE),
        "encoder.actor_encoder.net.mlp.2": (4, 8),
        "encoder.critic_encoder.net.mlp.0": (8, SIZE),
        "encoder.critic_encoder.net.mlp.2": (4, 8),
        "pi.net.mlp.0": (sum(CHOICES), 4),
        "vf.net.mlp.0": (1, 4),
    }
    state = {}
    for name, shape in shapes.items():
        state[f"{name}.weight"] = np.ones(shape, np.float32)
        state[f"{name}.bias"] = np.ones(shape[0], np.float32)
    weights = sb3_names(state)
    assert len(weights) == len(state)
    assert "mlp_extractor.value_net.2.bias" in weights
    assert MlpDriver(weights).best(np.zeros((1, SIZE), np.float32)).shape == (1, 5)


class FakeAlgorithm:
    """An algorithm whose checkpoint and policy are its number of iterations."""

    def __init__(self, iteration=0):
        self.iteration = iteration
        self.learner_group, self.env_runner_group = self, self

    def foreach_learner(self, _):
        return [SimpleNamespace(get=lambda: {"pi.net.mlp.0.bias": np.float32([self.iteration])})]

    def save_to_path(self, path):
        Path(path).mkdir()
        Path(path, "iteration").write_text(str(self.iteration))

    def restore_from_path(self, path):
        self.iteration = int(Path(path, "iteration").read_text())

    def sync_weights(self, **_):
        pass


def restored(folder, monkeypatch):
    """Returns the iteration from which a run continues."""
    config = SimpleNamespace(build_algo=FakeAlgorithm)
    monkeypatch.setattr(selfplay, "build_config", lambda _: config)
    return selfplay._algorithm(RLlibArguments(), folder).iteration


def test_a_run_that_is_killed_while_it_writes_a_checkpoint_continues(tmp_path, monkeypatch):
    selfplay._save(FakeAlgorithm(5), tmp_path)

    def killed(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", killed)
        with pytest.raises(KeyboardInterrupt):
            selfplay._save(FakeAlgorithm(10), tmp_path)
    assert load_weights(tmp_path / "policy.safetensors")["action_net.bias"] == [10]
    assert restored(tmp_path, monkeypatch) == 5
    selfplay._save(FakeAlgorithm(10), tmp_path)
    assert restored(tmp_path, monkeypatch) == 10
    assert [path.name for path in selfplay._checkpoints(tmp_path)] == ["checkpoint-000010"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--iterations", "0"], "iterations is 0"),
        (["--bots", "18"], "more than 20 karts"),
        (["--train-batch-size", "256"], "batch_size is 512, expected at most 256"),
    ],
)
def test_invalid_arguments_are_reported(words, text, capsys):
    assert main(["--output", "run", *words]) == 1
    assert text in capsys.readouterr().err


@pytest.mark.skipif(importlib.util.find_spec("ray") is not None, reason="Ray is installed")
def test_without_ray_the_error_says_what_to_install(tmp_path, capsys):
    assert main(["--output", str(tmp_path / "run")]) == 1
    assert install_command("rllib") in capsys.readouterr().err
