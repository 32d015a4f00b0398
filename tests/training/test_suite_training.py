"""The reference algorithms of the suite learn, resume, and write agents that race."""

import numpy as np
import pytest

from stkzoo.agents.pretrained.weights import save_weights
from stkzoo.agents.training.common.actors import SharedArray
from stkzoo.agents.training.common.learner import RolloutResult
from stkzoo.agents.training.common.ppo import advantages_of
from stkzoo.agents.training.suite.actor import (
    KartRace,
    TaskActor,
    reward_shares,
    rollout_type,
)
from stkzoo.agents.training.suite.algorithms import FSP, IPPO, MAPPO, PFSP
from stkzoo.agents.training.suite.exploit import Exploiter, ExploiterArguments, start_weights
from stkzoo.agents.training.suite.impala import IMPALA, vtrace
from stkzoo.agents.training.suite.learner import TaskArguments
from stkzoo.agents.training.suite.network import TaskNetwork
from stkzoo.agents.training.suite.past import PastActor
from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.race import run_race
from stkzoo.suite import find_task

SMALL = {
    "task": "solo-1",
    "hidden": (16, 16),
    "n_steps": 16,
    "keep_every": 32,
    "n_epochs": 2,
    "batch_size": 32,
    "num_races": 2,
    "num_starts": 2,
    "actors": 1,
    "checkpoint_every": 2,
    "anneal_timesteps": 1000,
}


def small_run(folder, kind=IPPO, **changes):
    return kind(folder, TaskArguments(**SMALL | changes))


def iterate(learner, count):
    for _ in range(count):
        learner.iterate()
        learner.save_policy()
        if learner.is_checkpoint(learner.iteration):
            learner.save_checkpoint()
            learner.begin_races()


def arrays_of(learner):
    policy, critic = learner._network.weights()
    return {**{f"policy {n}": a for n, a in policy.items()}, **critic}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "task", "actors"),
    [
        (IPPO, "solo-1", 2),
        pytest.param(MAPPO, "solo-1", 1, marks=pytest.mark.matrix),
        pytest.param(FSP, "selfplay-5", 1, marks=pytest.mark.matrix),
        pytest.param(PFSP, "team-2v2", 1, marks=pytest.mark.matrix),
        pytest.param(IMPALA, "selfplay-5", 2, marks=pytest.mark.matrix),
    ],
)
def test_a_run_learns_and_resumes_bit_for_bit(tmp_path, kind, task, actors):
    whole = small_run(tmp_path / "whole", kind, task=task, actors=actors)
    before = arrays_of(whole)
    iterate(whole, 4)
    first = small_run(tmp_path / "parts", kind, task=task, actors=actors)
    iterate(first, 2)
    first.close()
    second = small_run(tmp_path / "parts", kind, task=task, actors=actors)
    assert second.iteration == 2
    assert second.kart_steps == first.kart_steps > 0
    iterate(second, 2)
    one, other = arrays_of(whole), arrays_of(second)
    whole.close(), second.close()
    assert all((one[name] == other[name]).all() for name in one)
    assert any((one[name] != before[name]).any() for name in one)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "task"), [(MAPPO, "team-2v2"), (IMPALA, "solo-1")])
def test_every_algorithm_learns(tmp_path, kind, task):
    learner = small_run(tmp_path, kind, task=task)
    before = arrays_of(learner)
    iterate(learner, 2)
    after = arrays_of(learner)
    learner.close()
    assert any((after[name] != before[name]).any() for name in after)


@pytest.mark.slow
def test_an_interrupted_run_loses_the_policies_after_its_checkpoint(tmp_path):
    learner = small_run(tmp_path)
    iterate(learner, 3)
    learner.close()
    kept = sorted(tmp_path.glob("policy-*"))
    small_run(tmp_path).close()
    assert sorted(tmp_path.glob("policy-*")) == kept[:2] != kept
    with pytest.raises(ConfigError, match="n_steps was 16, now 8"):
        small_run(tmp_path, n_steps=8)


def test_a_task_with_messages_is_refused_before_anything_starts(tmp_path):
    with pytest.raises(ConfigError, match="talk-2v2 has messages"):
        small_run(tmp_path, task="talk-2v2")
    assert not list(tmp_path.iterdir())


def test_members_of_a_team_get_the_mean_of_their_rewards():
    shares = reward_shares(find_task("team-2v2"))
    own = np.array([4.0, 1.0, 3.0, 2.0])
    assert (own @ shares).tolist() == [3.0, 2.0, 2.0, 3.0]
    assert (reward_shares(find_task("versus")) == np.eye(1)).all()


def test_a_rollout_has_shared_rewards_and_the_learners_own_values():
    size = find_task("team-2v2").state_size
    memory = SharedArray((2, 40, 4), rollout_type(size))
    task = find_task("team-2v2")
    options = {"num_races": 1, "num_starts": 1, **task.options()}
    actor = TaskActor(options, reward_shares(task), memory)
    network = TaskNetwork((8, 8), 0, size)
    actor.begin([5])
    try:
        driven = actor.drive(0, *network.weights())
    finally:
        actor.close()
    rollout = memory.array()[0]
    assert rollout["active"].all()
    assert (rollout["state"] == rollout["state"][:, :1]).all()
    assert (rollout["state"][0] != rollout["state"][20]).any()
    assert not rollout["ended"].any()
    assert driven.finishes == []
    assert (rollout["rewards"][:, 0] == rollout["rewards"][:, 3]).all()
    assert (rollout["rewards"][:, 1] == rollout["rewards"][:, 2]).all()
    assert (rollout["rewards"][:, 0] != rollout["rewards"][:, 1]).any()
    columns = network.tensors(rollout[3])
    log_probability, entropy, _, values = network.evaluate(columns)
    told = rollout["log_probability"][3]
    assert np.allclose(log_probability.detach().numpy(), told, atol=1e-4)
    assert np.allclose(values.detach().numpy() * 10.0, rollout["values"][3], atol=1e-4)
    assert (entropy > 0).all()


@pytest.mark.slow
def test_the_command_trains_an_agent_that_races(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        "stkzoo.agents.training.suite.learner.TaskArguments",
        lambda **given: TaskArguments(**{**SMALL, "checkpoint_every": 100, **given}),
    )
    words = ["suite", "train", "solo-1", "ippo", "--kart-steps", "100", "--output", str(tmp_path)]
    assert main(words) == 0
    assert f"stkzoo suite evaluate solo-1 {tmp_path / 'agent'}" in capsys.readouterr().out
    result = run_race([str(tmp_path / "agent")], track="lighthouse", max_steps=20, inline=True)
    assert not result.has_errors
    assert result.agents[0].driver == "ippo_solo_1_0"
    assert main(words) == 0  # the run is already complete


def test_self_play_is_refused_for_one_learner(tmp_path):
    with pytest.raises(ConfigError, match="solo-1 has one learner, and fsp is self-play"):
        small_run(tmp_path, FSP)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["team-2v2", "selfplay-5"])
def test_a_past_policy_drives_a_team_or_two_karts_and_is_not_learned_from(tmp_path, name):
    task = find_task(name)
    memory = SharedArray((2, 400, task.learners), rollout_type(0))
    options = {"num_races": 1, "num_starts": 1, **task.options(), "max_cycles": 60}
    network = TaskNetwork((8, 8), 0)
    past = TaskNetwork((8, 8), 1)
    save_weights(tmp_path / "past.safetensors", past.weights()[0])
    actor = PastActor(options, reward_shares(task), memory, folder=tmp_path, teams=task.teams)
    actor.begin([5])
    try:
        driven = actor.drive(0, *network.weights(), {"past.safetensors": 1.0})
    finally:
        actor.close()
    rollout = memory.array()[0]
    ends = np.flatnonzero(rollout["active"].any(axis=1) & rollout["ended"].any(axis=1)) + 1
    races = np.split(rollout, ends)
    learned = [tuple(np.flatnonzero(race["active"].any(axis=0))) for race in races]
    counts = {len(slots) for slots in learned}
    assert counts == {task.learners, task.learners - task.learners // 2}
    if task.teams:
        assert {*learned} - {(0, 1, 2, 3)} <= {(0, 3), (1, 2)}
    assert driven.duels
    assert all(who == "past.safetensors" and 0 <= beaten <= 1 for who, beaten in driven.duels)
    assert len(driven.finishes) < task.learners * (len(races) - 1)


@pytest.mark.slow
def test_prioritized_self_play_meets_the_hardest_rivals_most_often(tmp_path):
    learner = small_run(tmp_path, PFSP, task="team-2v2")
    even = small_run(tmp_path / "even", FSP, task="team-2v2")
    try:
        for run in (learner, even):
            for name in ("strong", "weak"):
                run.save_policy(tmp_path / name)
            for _ in range(50):
                run._pool.update("strong", 0.0)
                run._pool.update("weak", 1.0)
        (odds,), (equal,) = learner._drive_options(), even._drive_options()
    finally:
        learner.close(), even.close()
    assert odds["strong"] > 0.9
    assert odds["strong"] + odds["weak"] == pytest.approx(1)
    assert equal == {"strong": 0.5, "weak": 0.5}


def random_rollout(steps, slots):
    random = np.random.default_rng(3)
    rollout = np.zeros((steps, slots), rollout_type(0))
    for name in ("rewards", "values", "next_values"):
        rollout[name] = random.normal(size=rollout.shape)
    rollout["ended"] = random.random(rollout.shape) < 0.2
    rollout["next_values"] *= rollout["ended"]
    rollout["active"] = random.random(rollout.shape) < 0.9
    return rollout, random.normal(size=slots).astype(np.float32)


def test_v_trace_with_the_current_policy_equals_gae():
    rollout, last_values = random_rollout(20, 7)
    values = rollout["values"]
    targets, advantages = vtrace(rollout, values, np.ones_like(values), last_values, 0.9, 0.8)
    expected = advantages_of(rollout, last_values, 0.9, 0.8)
    assert np.allclose(targets - values, expected, atol=1e-5)
    assert (advantages[~rollout["active"]] == 0).all()
    returns, gained = vtrace(rollout, values, np.ones_like(values), last_values, 0.9, 1.0)
    assert np.allclose(gained, (returns - values), atol=1e-5)


def test_v_trace_clips_large_ratios_and_discounts_small_ones():
    rollout, _ = random_rollout(3, 1)
    rollout["ended"], rollout["active"] = False, True
    rollout["rewards"] = [[1.0], [2.0], [4.0]]
    values = np.array([[10.0], [20.0], [30.0]], np.float32)
    ratios = np.array([[0.5], [3.0], [0.25]], np.float32)
    targets, advantages = vtrace(
        rollout, values, ratios, np.array([40.0], np.float32), gamma=0.5, trace=1.0
    )
    last = 30.0 + 0.25 * (4.0 + 0.5 * 40.0 - 30.0)
    middle = 20.0 + (2.0 + 0.5 * 30.0 - 20.0) + 0.5 * (last - 30.0)
    first = 10.0 + 0.5 * (1.0 + 0.5 * 20.0 - 10.0) + 0.5 * 0.5 * (middle - 20.0)
    assert targets.ravel() == pytest.approx([first, middle, last])
    assert advantages.ravel() == pytest.approx(
        [
            0.5 * (1.0 + 0.5 * middle - 10.0),
            2.0 + 0.5 * last - 20.0,
            0.25 * (4.0 + 0.5 * 40.0 - 30.0),
        ]
    )


@pytest.mark.slow
def test_v_trace_learns_beside_karts_that_wait_for_the_end_of_their_race(tmp_path):
    learner = small_run(tmp_path, IMPALA)
    rollout, last_values = random_rollout(16, 4)
    try:
        for own_steps in ((0, 0, 0, 0), (0, 0, 16, 0), (1, 0, 0, 0), (16, 16, 16, 1)):
            rollout["active"] = rollout["driven"] = np.arange(16)[:, None] < own_steps
            figures = learner._update([rollout], [RolloutResult(last_values, [])])
            assert all(np.isfinite(value) for value in figures.values())
            assert all(np.isfinite(array).all() for array in arrays_of(learner).values())
            assert ("kl" in figures) == (max(own_steps) > 1)
    finally:
        learner.close()


def exploiter(folder, **changes):
    small = {**SMALL, "task": "solo-general", "driver": "pursuit", "hidden": (8, 8)}
    return Exploiter(folder, ExploiterArguments(**small | changes))


@pytest.mark.slow
def test_an_exploiter_starts_from_an_agent_and_drives_one_kart_against_the_frozen_driver(tmp_path):
    start = TaskNetwork((16, 8), 5).weights()[0]
    save_weights(tmp_path / "policy.safetensors", start)
    init = str(tmp_path / "policy.safetensors")
    learner = exploiter(tmp_path / "run", init=init, hidden=(16, 8))
    try:
        own = learner._network.weights()[0]
        assert all((own[name] == start[name]).all() for name in start)
        line = learner.iterate()
        learner._recent.extend(
            [KartRace(1.0, True, 1), KartRace(1.0, True, 2), KartRace(1.0, False, 1)]
        )
        figures = learner._figures()
    finally:
        learner.close()
    assert line["kart_steps"] == 2 * 16
    assert figures["won"] == pytest.approx(1 / 3)
    with pytest.raises(ConfigError, match=r"layers of \(16, 8\) units, expected \(8, 16\)"):
        start_weights(init, (8, 16))


def test_an_unknown_algorithm_is_refused(capsys):
    assert main(["suite", "train", "solo-1", "ipo"]) == 2
    assert "unknown algorithm 'ipo'. Did you mean 'ippo'?" in capsys.readouterr().err


@pytest.mark.parametrize("words", [("train", "solo-1", "ippo"), ("exploit", "heuristic")])
def test_numbers_out_of_bounds_are_refused(tmp_path, capsys, words):
    assert main(["suite", *words, "--seed", "1" * 22, "--output", str(tmp_path / "run")]) == 2
    assert "expected a whole number from 0 to" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("words", [("train", "solo-1", "ippo"), ("exploit", "heuristic")])
def test_a_file_as_output_is_an_error_with_a_remedy(tmp_path, capsys, words):
    file = tmp_path / "file"
    file.touch()
    assert main(["suite", *words, "--output", str(file)]) == 2
    error = capsys.readouterr().err
    assert f"the run's folder {file} cannot be used: " in error
    assert "choose another --output" in error
