"""RLlib's learner with episodes from stkzoo's env runner. These tests need Ray."""

import math
import os
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from stkzoo.agents.pretrained.mlp import log_probability_of
from stkzoo.agents.training.rllib.races import MAIN, PackSender, RLlibArguments

pytest.importorskip("ray.rllib")
pytestmark = pytest.mark.filterwarnings("ignore")

GAMMA, GAE_LAMBDA = 0.9, 0.8
ARGUMENTS = RLlibArguments(
    env_runners=0,
    envs_per_runner=2,
    tracks=("lighthouse",),
    max_cycles=20,
    learners=2,
    frozen=1,
    bots=0,
    slots=2,
    hidden=(16,),
    train_batch_size=50,
    batch_size=25,
    n_epochs=1,
    promote_at=1.0,
    gamma=GAMMA,
    gae_lambda=GAE_LAMBDA,
)


@pytest.fixture(scope="module")
def algorithm():
    import ray

    from stkzoo.agents.training.rllib.selfplay import build_config

    ray.init(address="local", num_cpus=1, include_dashboard=False, log_to_driver=False)
    algorithm = build_config(ARGUMENTS).build_algo()
    yield algorithm
    algorithm.stop()
    ray.shutdown()


def learner_of(algorithm):
    return algorithm.learner_group._learner


def values_of(module, observations):
    import torch

    with torch.no_grad():
        return module.compute_values({"obs": torch.as_tensor(observations)}).numpy()


def targets_of(episode, module):
    """Returns value targets from generalized advantage estimation, computed step by step."""
    values = values_of(module, episode.get_observations())
    rewards = episode.get_rewards()
    if episode.is_terminated:
        values[-1] = 0.0
    advantage, targets = 0.0, []
    for step in reversed(range(len(rewards))):
        error = rewards[step] + GAMMA * values[step + 1] - values[step]
        advantage = error + GAMMA * GAE_LAMBDA * advantage
        targets.append(advantage + values[step])
    return targets[::-1]


def test_the_learner_bootstraps_fragments_and_truncations_but_not_finishes(algorithm):
    learner, runner = learner_of(algorithm), algorithm.env_runner
    episodes = runner.sample(num_timesteps=60) + runner.sample(num_timesteps=60)
    assert {episode.is_truncated for episode in episodes} == {True, False}
    episodes[0].is_terminated, episodes[0].is_truncated = True, False
    expected = [target for e in episodes for target in targets_of(e, learner.module[MAIN])]
    batch = learner._learner_connector(
        rl_module=learner.module,
        batch={},
        episodes=episodes,
        shared_data={},
        metrics=learner.metrics,
    )
    assert list(batch) == [MAIN]
    mask = batch[MAIN]["loss_mask"].numpy()
    assert mask.sum() == len(expected)
    np.testing.assert_allclose(
        batch[MAIN]["value_targets"].numpy()[mask], expected, rtol=1e-4, atol=1e-5
    )


def test_networks_of_the_kernel_and_the_learner_agree(algorithm):
    import torch

    module = learner_of(algorithm).module[MAIN]
    for episode in algorithm.env_runner.sample(num_timesteps=20):
        seen = torch.as_tensor(episode.get_observations(slice(0, len(episode))))
        with torch.no_grad():
            logits = module.forward_exploration({"obs": seen})["action_dist_inputs"].numpy()
        outputs = episode.get_extra_model_outputs
        np.testing.assert_allclose(outputs("action_dist_inputs"), logits, atol=1e-4)
        expected = module.get_exploration_action_dist_cls().from_logits(torch.as_tensor(logits))
        taken = expected.logp(torch.as_tensor(episode.get_actions())).numpy()
        np.testing.assert_allclose(outputs("action_logp"), taken, atol=1e-4)
        own = log_probability_of(episode.get_actions(), logits)
        np.testing.assert_allclose(own, taken, atol=1e-4)


def test_an_iteration_reports_the_learners_steps_and_the_races(algorithm):
    figures = [algorithm.train()["env_runners"] for _ in range(2)]
    steps = [found["num_module_steps_sampled_lifetime"][MAIN] for found in figures]
    assert 50 <= steps[1] - steps[0] < 54
    assert figures[1]["races"] >= 2
    assert np.isfinite(figures[1]["episode_return_mean"])


def test_a_snapshot_drives_from_the_next_sample(algorithm):
    from stkzoo.agents.training.rllib.runner import copy_main

    algorithm.train()
    copy_main(algorithm, "past_1")
    modules = algorithm.env_runner.module
    main, past = (modules[name].state_dict() for name in (MAIN, "past_1"))
    policy = [name for name in past if "actor" in name or name.startswith("pi.net")]
    assert len(policy) == 4  # the critic stays with the learner
    assert all((main[name] == past[name]).all() for name in policy)


@pytest.mark.usefixtures("algorithm")  # starts Ray
def test_a_killed_env_runner_is_restarted():
    from stkzoo.agents.training.rllib.selfplay import build_config

    remote = build_config(replace(ARGUMENTS, env_runners=1)).build_algo()
    try:
        before = remote.train()["env_runners"]["num_env_steps_sampled_lifetime"]
        group = remote.env_runner_group
        (pid,) = group.foreach_env_runner(lambda _: os.getpid(), local_env_runner=False)
        os.kill(pid, signal.SIGKILL)
        results = (remote.train() for _ in range(100))
        result = next(found for found in results if found["restarted"])
        while result["env_runners"]["num_env_steps_sampled_lifetime"] == before:
            result = remote.train()
    finally:
        remote.stop()


def self_play(monkeypatch, **changes):
    """Returns the callback of a run, and the snapshots that it saves."""
    from stkzoo.agents.training.rllib import runner

    saved = []
    monkeypatch.setattr(runner, "copy_main", lambda _, module: saved.append(module))
    arguments = replace(ARGUMENTS, least_races=20, promote_at=0.6, **changes)
    return runner.SelfPlay(arguments), saved


def iterate(callback, races, ended, won=0.0, returns=0.0):
    """Ends an iteration in which some races ended; returns its share of duels won and return."""
    sums = {"num_episodes": ended, "win_shares": won, "returns": returns} if ended else {}
    result = {"env_runners": {"races": races, "win_shares": math.nan, **sums}}
    callback.on_train_result(algorithm=None, result=result)
    return result["win_share"], result["return"]


def test_a_snapshot_needs_wins_in_all_races_since_the_last_one(monkeypatch):
    callback, saved = self_play(monkeypatch)
    iterate(callback, 19, 19)
    assert iterate(callback, 20, 1, won=1.0)[0] == 1 / 20
    assert saved == []
    assert iterate(callback, 50, 30, won=30.0)[0] == 31 / 50
    assert saved == ["past_0"]
    assert iterate(callback, 69, 19, won=19.0)[0] == 1.0
    assert saved == ["past_0"]


def test_a_snapshot_is_not_saved_without_a_race(monkeypatch):
    callback, saved = self_play(monkeypatch)
    assert math.isnan(iterate(callback, 30, 0)[0])
    assert saved == []


def test_figures_cover_the_latest_50_races(monkeypatch):
    callback, _ = self_play(monkeypatch, frozen=0)
    iterate(callback, 10, 10, returns=990.0)
    for races in range(20, 70, 10):
        share, mean = iterate(callback, races, 10, returns=10.0)
    assert math.isnan(share)
    assert mean == 1.0


def test_figures_count_the_races_of_all_env_runners_once(algorithm):
    from stkzoo.agents.training.rllib.runner import RETURNS, WIN_SHARES
    from stkzoo.agents.training.rllib.sampler import SampledRace

    runner = algorithm.env_runner
    runner.get_metrics()  # those of other tests
    for reward, share in ((1.0, 0.5), (3.0, 1.0), (5.0, None)):
        runner._log_race(SampledRace(reward, share))
    sums = runner.get_metrics()
    assert [sums[name].peek() for name in ("num_episodes", RETURNS, WIN_SHARES)] == [3, 9.0, 1.5]


@pytest.mark.usefixtures("algorithm")  # starts Ray
def test_a_resumed_run_has_other_seeds(tmp_path, monkeypatch):
    from stkzoo.agents.training.rllib import runner, selfplay

    seeds, make = [], runner.RaceSampler

    def sampler(*given):
        seeds.append(given[-1])
        return make(*given)

    monkeypatch.setattr(runner, "RaceSampler", sampler)
    for _ in range(2):
        run = selfplay._algorithm(ARGUMENTS, tmp_path)
        run.train()
        selfplay._save(run, tmp_path)
        run.stop()
    assert seeds == [[0, 0, 0], [0, 0, 1]]


@pytest.mark.usefixtures("algorithm")  # starts Ray
def test_two_runs_on_a_cluster_send_their_own_packs(tmp_path):
    import ray

    (tmp_path / "ours").write_bytes(b"ours")
    (tmp_path / "theirs").write_bytes(b"theirs")
    sender = PackSender.start(str(tmp_path / "ours"))
    other = """
import sys, ray
from stkzoo.agents.training.rllib.races import PackSender
ray.init(address=sys.argv[1], log_to_driver=False)
sender = PackSender.start(sys.argv[2])
assert ray.get(sender.pack.remote()) == b"theirs"
ray.kill(sender)
"""
    address = ray.get_runtime_context().gcs_address
    words = [sys.executable, "-c", other, address, str(tmp_path / "theirs")]
    subprocess.run(words, check=True)
    assert ray.get(sender.pack.remote()) == b"ours"
    ray.kill(sender)


def test_an_address_without_a_cluster_is_reported(tmp_path, monkeypatch, capsys):
    import ray

    from stkzoo.agents.training.rllib.selfplay import main

    def refuse(**_):
        raise ConnectionError("no cluster")

    monkeypatch.setattr(ray, "init", refuse)
    assert main(["--output", str(tmp_path / "run"), "--address", "auto"]) == 1
    assert "Ray does not start with the address 'auto' (no cluster)" in capsys.readouterr().err
