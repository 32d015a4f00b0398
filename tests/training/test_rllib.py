"""The RLlib script, without training.

Ray needs an older Gymnasium than the tests; ``python -m benchmarks.ecosystem`` trains with it.
"""

import importlib.util
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from stkzoo._installation import install_command
from stkzoo.agents.pretrained.mlp import MlpDriver
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.agents.training.rllib import selfplay
from stkzoo.agents.training.rllib.races import (
    MAIN,
    RLlibArguments,
    ensure_assets,
    make_races,
    win_share,
)
from stkzoo.agents.training.rllib.sampler import RaceSampler, sb3_names
from stkzoo.agents.training.rllib.selfplay import main
from stkzoo.engine.assets import find_assets
from stkzoo.errors import AssetError
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


def test_the_share_of_pairs_won_counts_all_pairs():
    assert win_share([1, 4], [2, 3]) == 0.5
    assert win_share([1], [2]) == 1.0
    assert win_share([1, 2], []) is None


def test_races_follow_the_arguments():
    arguments = RLlibArguments(
        tracks=("lighthouse",), learners=2, frozen=1, bots=2, max_cycles=7, envs_per_runner=2
    )
    with closing(make_races(arguments)) as races:
        observations, _ = races.reset(seed=1)
        assert observations.shape == (6, SIZE)
        assert races.races[0].options.num_kart == 5
        assert {race.race.track for race in races.races} == {"lighthouse"}
        sampler = RaceSampler(races, arguments, seed=1)
        sampler.load(dict.fromkeys(arguments.modules, MlpDriver(small_network(inputs=SIZE))))
        fragments = sampler.sample(2 * 2 * 7)
        assert [len(fragment) for fragment in fragments] == [7] * 4
        assert all(f.is_truncated and not f.is_terminated for f in fragments)


class FakeRaces:
    """Two races with three slots each; observations are slot, step and number of the race.

    Slot ``s`` finishes after ``lengths[s]`` steps, or is truncated at step 5.
    """

    num_races, num_agents, num_envs = 2, 3, 6

    def __init__(self, lengths, crash_at=None):
        self._lengths, self._crash_at = np.array(lengths), crash_at
        self._ages, self._starts = np.zeros(6, int), np.zeros(6, int)
        self._steps = 0
        self.racing = np.zeros(6, bool)
        self.acted = []

    def _observations(self):
        seen = np.zeros((6, SIZE), np.float32)
        seen[:, :3] = np.stack([np.arange(6), self._ages, self._starts], axis=1)
        return seen

    def reset_slots(self, seeds, options):
        assert len(seeds) == len(options) == 2
        self.racing = np.ones(6, bool)
        return SimpleNamespace(observations=self._observations())

    def step_async(self, actions):
        self.acted.append(actions)

    def wait_slots(self):
        active = self.racing
        self._steps += 1
        self._ages += active
        crashed = np.repeat([self._steps == self._crash_at, False], 3)
        terminations = active & (self._ages == self._lengths) & ~crashed
        truncations = active & ~terminations & ((self._ages == 5) | crashed)
        self.racing = active & ~terminations & ~truncations
        final = self._observations()
        finals = {
            slot: (final[slot], {"position": slot % 3 + 1})
            for slot in np.flatnonzero(terminations | truncations).tolist()
        }
        for race in (slice(0, 3), slice(3, 6)):
            if not self.racing[race].any():
                self._ages[race], self.racing[race] = 0, True
                self._starts[race] += 1
        return SimpleNamespace(
            active=active,
            rewards=active * np.arange(6.0),
            terminations=terminations,
            truncations=truncations,
            crashed=crashed,
            finals=finals,
            observations=self._observations() * self.racing[:, None],
        )


def sampler_of(races, **likes):
    """Returns a sampler for two learners and a past version; ``likes`` gives preferred choices."""
    sampler = RaceSampler(races, RLlibArguments(learners=2, frozen=1, slots=2), seed=3)
    for module in (MAIN, "past_0", "past_1"):
        network = small_network(likes.get(module, ()), inputs=SIZE)
        sampler.load({module: MlpDriver(network)})
    return sampler


def moments(fragment):
    """Returns the slot, step and race number from each observation of a fragment."""
    return fragment.observations[:, :3].astype(int).tolist()


def test_only_the_learners_karts_are_recorded():
    fragments = sampler_of(FakeRaces([9] * 6)).sample(8)
    assert [fragment.slot for fragment in fragments] == [0, 1, 3, 4]
    assert all(len(fragment) == 2 for fragment in fragments)


def test_an_unfinished_episode_continues_in_the_next_sample():
    sampler = sampler_of(FakeRaces([9] * 6))
    first, second = (sampler.sample(8)[1] for _ in range(2))
    assert moments(first) == [[1, 0, 0], [1, 1, 0], [1, 2, 0]]
    assert moments(second) == [[1, 2, 0], [1, 3, 0], [1, 4, 0]]
    assert [first.begin, second.begin] == [0, 2]
    assert not any(f.is_terminated or f.is_truncated for f in (first, second))


def test_a_kart_that_finishes_is_terminated_at_its_last_observation():
    fragments = sampler_of(FakeRaces([2, 9, 9, 9, 9, 9])).sample(16)
    first = fragments[0]
    assert moments(first) == [[0, 0, 0], [0, 1, 0], [0, 2, 0]]
    assert first.is_terminated
    assert not first.is_truncated
    assert first.rewards.tolist() == [0.0, 0.0]


def test_a_race_at_its_time_limit_is_truncated_before_the_next_one():
    fragments = [f for f in sampler_of(FakeRaces([9] * 6)).sample(24) if f.slot == 4]
    assert [len(fragment) for fragment in fragments] == [5, 1]
    assert moments(fragments[0])[-1] == [4, 5, 0]
    assert [fragment.is_truncated for fragment in fragments] == [True, False]
    assert moments(fragments[1]) == [[4, 0, 1], [4, 1, 1]]


def test_each_kart_is_driven_by_the_network_of_its_module():
    races = FakeRaces([9] * 6)
    sampler_of(races, main=[2], past_0=[4], past_1=[4]).sample(8)
    assert races.acted[0][:, 0].tolist() == [2, 2, 4, 2, 2, 4]


def test_log_probabilities_match_the_actions():
    fragment = sampler_of(FakeRaces([9] * 6)).sample(8)[0]
    expected = np.zeros(len(fragment))
    for choice, logits in enumerate(np.split(fragment.logits, np.cumsum(CHOICES)[:-1], axis=1)):
        odds = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
        expected += np.log(odds[np.arange(len(odds)), fragment.actions[:, choice]])
    np.testing.assert_allclose(fragment.log_probabilities, expected, rtol=1e-5)


def test_results_cover_whole_races():
    sampler = sampler_of(FakeRaces([9] * 6))
    sampler.sample(12)
    assert sampler.results == []
    sampler.sample(12)
    first, second = sampler.results
    assert first == (5.0, 1.0)
    assert second.reward == 5 * (3.0 + 4.0)


def test_a_race_that_crashes_is_truncated_and_has_no_result():
    sampler = sampler_of(FakeRaces([9] * 6, crash_at=3))
    fragments = sampler.sample(20)
    assert [f.is_truncated for f in fragments if f.slot == 0] == [True, False]
    assert [result.reward for result in sampler.results] == [35.0]


def test_a_node_without_data_needs_a_pack(tmp_path, monkeypatch):
    empty = tmp_path / "cache"
    monkeypatch.setenv("STKZOO_CACHE", str(empty))
    monkeypatch.setenv("SUPERTUXKART_DATADIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    try:
        find_assets()
    except AssetError:
        with pytest.raises(AssetError, match="give --pack FILE"):
            ensure_assets()
        with pytest.raises(AssetError):
            ensure_assets(archive=str(tmp_path / "no.tar.xz"))
    else:
        ensure_assets()  # the game is installed on this system


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
    assert restored(tmp_path, monkeypatch) == 5
    selfplay._save(FakeAlgorithm(10), tmp_path)
    assert restored(tmp_path, monkeypatch) == 10
    assert [path.name for path in selfplay._checkpoints(tmp_path)] == ["checkpoint-000010"]


def test_the_policy_is_never_older_than_the_checkpoint(tmp_path, monkeypatch):
    selfplay._save(FakeAlgorithm(5), tmp_path)

    def killed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "rename", killed)
    with pytest.raises(KeyboardInterrupt):
        selfplay._save(FakeAlgorithm(10), tmp_path)
    assert load_weights(tmp_path / "policy.safetensors")["action_net.bias"] == [10]


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
