"""Learning by self-play: it learns, ends, and resumes after a kill with the same result."""

import json
import os
import subprocess
import sys
from dataclasses import asdict

import numpy as np
import pytest
import torch

from stkzoo.agents.planning.driver import CHOICES, HEADS, INPUT_SIZE, PolicyInput
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.pretrained.policy import RacingPolicy, network_shapes
from stkzoo.agents.pretrained.weights import save_weights
from stkzoo.agents.training.common.actors import SharedArray
from stkzoo.agents.training.common.matches import match_driver
from stkzoo.agents.training.common.run_folder import run_parameters
from stkzoo.agents.training.evaluate import main as evaluate_main
from stkzoo.agents.training.evaluate import newest_policy
from stkzoo.agents.training.export import export_policy
from stkzoo.agents.training.plot import main as plot_main
from stkzoo.agents.training.ppo.network import PlanNetwork, initial_weights
from stkzoo.agents.training.ppo.rollouts import ActorArguments, RaceActor, plan_shape, sample
from stkzoo.agents.training.ppo.run import PPORun
from stkzoo.agents.training.ppo.selfplay import SelfPlayArguments, main, selfplay_setup
from stkzoo.agents.training.ppo.update import advantages_of
from stkzoo.errors import ConfigError
from tests.support.networks import small_network
from tests.support.training import last_policy, log_of, run_and_kill, words_of

SMALL = {
    "tracks": ("lighthouse",),
    "races": ("2", "1+1"),
    "actors": 2,
    "n_steps": 16,
    "n_epochs": 2,
    "batch_size": 32,
    "hidden": (16, 16),
    "warm_up": 1,
    "checkpoint_every": 2,
}


def run_of(folder, **changes):
    arguments = SelfPlayArguments(**SMALL | changes)
    return PPORun(folder, arguments, selfplay_setup(arguments))


def words(folder, until, **changes):
    return words_of(folder, SMALL, total_timesteps=until, **changes)


def learn(folder, until, **changes):
    return main(words(folder, until, **changes))


@pytest.mark.slow
def test_it_learns_and_ends(tmp_path):
    command = [sys.executable, "-m", "stkzoo.agents.training.ppo.selfplay"]
    command += words(tmp_path / "run", 150, learning_rate=0.01)
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    log = log_of(tmp_path / "run")
    assert log[-1]["kart_steps"] >= 150
    assert [line["iteration"] for line in log] == list(range(1, len(log) + 1))
    assert all(np.isfinite(list(line.values())).all() for line in log)
    assert log[0]["kl"] < 1e-5  # during warm-up, only the value function learns
    assert log[-1]["kl"] > 1e-5
    assert last_policy(tmp_path / "run")["w0"].shape == (INPUT_SIZE, 16)
    assert list((tmp_path / "run").glob("events.out.tfevents.*"))


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
def test_a_killed_run_resumes_as_if_uninterrupted(tmp_path):
    assert learn(tmp_path / "whole", 480) == 0
    killed = tmp_path / "killed"
    # Kill it one iteration after a checkpoint, so that the iteration is lost.
    run_and_kill(main, words(killed, 100_000), killed / "log.jsonl", lines=5)
    assert learn(killed, 480) == 0
    assert log_of(killed) == log_of(tmp_path / "whole")
    ours, theirs = last_policy(killed), last_policy(tmp_path / "whole")
    assert all((ours[name] == theirs[name]).all() for name in theirs)


@pytest.mark.matrix
def test_a_run_continues_without_the_weights_that_it_started_from(tmp_path):
    learn(tmp_path / "first", 1)
    (file,) = (tmp_path / "first").glob("policy-*.safetensors")
    learn(tmp_path / "run", 1, init=str(file))
    file.unlink()
    assert learn(tmp_path / "run", 100, init=str(file)) == 0
    assert len(log_of(tmp_path / "run")) > 1


@pytest.mark.slow
def test_other_arguments_are_refused(tmp_path, capsys):
    assert learn(tmp_path, 40) == 0
    assert learn(tmp_path, 80, learning_rate=0.001) != 0
    assert "learning_rate was 0.0003, now 0.001" in capsys.readouterr().err


@pytest.mark.matrix
def test_a_run_refuses_changed_parameters_of_its_plans(tmp_path, capsys):
    assert learn(tmp_path, 40) == 0
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    facts = json.loads(state["facts"])
    facts["history"][-1]["rules"]["margin"] = 9.0
    torch.save(state | {"facts": json.dumps(facts)}, tmp_path / "checkpoint.pt")
    assert learn(tmp_path, 80) != 0
    assert "margin was 9.0, now" in capsys.readouterr().err


@pytest.mark.slow
def test_choices_that_are_not_learned_stay_at_those_of_the_plans(tmp_path):
    begin, turn, *_ = HEADS
    changes = {"warm_up": 0, "learns": ("begin", "fire")}
    learner = run_of(tmp_path, **changes)
    before = learner.network.policy_weights()
    learner.iterate()
    drawn = np.concatenate([memory[0]["choices"][..., 1].ravel() for memory in learner._rollouts])
    weights = learner.network.policy_weights()
    learner.close()
    assert set(drawn.tolist()) == {CHOICES[1] // 2}
    assert not weights["w2"][:, turn].any()
    assert (weights["w2"][:, begin] != before["w2"][:, begin]).any()


@pytest.mark.slow
def test_a_held_offset_is_chosen_once_for_all_its_steps(tmp_path):
    plans = tmp_path / "plans.json"
    plans.write_text('{"turn_hold": 4}')
    changes = {"n_steps": 32, "races": ("4x1",), "learns": ("begin", "turn"), "plans": str(plans)}
    learner = run_of(tmp_path / "run", **changes)
    learner.iterate()
    rollout = learner._rollouts[0][0].copy()
    learner.close()
    chosen = rollout["choices"][..., 1].reshape(8, 4, 4)  # from the start of the race
    assert (chosen == chosen[:, :1]).all()
    assert len(np.unique(chosen)) > 1
    assert run_parameters(tmp_path / "run" / "policy.safetensors").turn_hold == 4


@pytest.mark.parametrize("names", [("steer",), ()])
def test_unknown_choices_are_refused(tmp_path, names):
    with pytest.raises(ConfigError, match="begin, turn, nitro, fire"):
        run_of(tmp_path, learns=names)


def test_weights_of_another_network_are_refused(tmp_path):
    file = tmp_path / "network.safetensors"
    save_weights(file, small_network())
    with pytest.raises(ConfigError, match="or another program"):
        run_of(tmp_path / "run", init=str(file))
    save_weights(file, RacingPolicy.of_plans_alone().weights)
    with pytest.raises(ConfigError, match="give --hidden 1 1"):
        run_of(tmp_path / "run", init=str(file))


def test_a_policy_that_does_not_observe_held_offsets_can_be_learned_further(tmp_path):
    random, file = np.random.default_rng(0), tmp_path / "older.safetensors"
    shapes = network_shapes((16, 16), holds=False).items()
    older = {name: random.normal(size=shape).astype(np.float32) for name, shape in shapes}
    save_weights(file, older)
    network = PlanNetwork([0], (16, 16), 0)
    network.start_from(initial_weights(str(file), (16, 16)))
    policy = network.policy_weights()
    inputs = random.normal(size=(3, INPUT_SIZE)).astype(np.float32)
    view = PolicyInput(inputs, np.zeros((3, sum(CHOICES)), np.float32))
    ours, theirs = (RacingPolicy(own).learned_logits(view) for own in (policy, older))
    assert len(policy["mean"]) == INPUT_SIZE > len(older["mean"])
    assert np.allclose(ours, theirs, atol=1e-4)


def test_distance_is_rewarded_and_returns_go_on_after_the_finish():
    """The network adds nothing to the plans, so that the most likely choices are theirs."""
    setup = selfplay_setup(SelfPlayArguments(tracks=("olivermath",), races=("1x1",), num_starts=1))
    network = PlanNetwork([0], (8, 8), 0)
    memory = SharedArray((2, 500, 1), network.shape.rollout_type())
    arguments = ActorArguments(setup.groups, network.shape, setup.plans, "", bootstraps_finish=True)
    actor = RaceActor(arguments, memory)
    try:
        actor.begin([3])
        _, critic = network.weights()
        plans = RacingPolicy.of_plans_alone().weights
        driven = actor.drive(0, plans, critic | {"b2": np.full(1, 0.5, np.float32)}, {})
    finally:
        actor.close()
    rollout = memory.array()[0, :, 0]
    race, *_ = driven.finishes
    end, *_ = np.flatnonzero(rollout["ended"])
    assert rollout["active"].all()  # the next race has started
    assert race.reward == pytest.approx(0.05 * 496, rel=0.1)  # a lap of 496 m
    assert (race.company, race.position) == ("alone", 1)
    assert 0.5 < race.ratio < 1.5
    assert rollout["next_values"][end] != 0
    assert not rollout["next_values"][:end].any()


@pytest.mark.matrix
def test_past_selves_join_a_run_as_opponents(tmp_path):
    changes = {"races": ("2x2",), "opponents": "prioritized", "max_cycles": 10, "keep_every": 20}
    assert learn(tmp_path, 400, **changes) == 0
    assert 0 <= log_of(tmp_path)[-1]["beaten"] <= 1


def test_sampled_choices_follow_their_probabilities():
    logits = np.zeros((4000, sum(CHOICES)), np.float32)
    logits[:, HEADS[2]] = 0.0, np.log(3.0)
    drawn, logs = sample(logits, np.random.default_rng(0), HEADS, [0, 2])
    assert drawn[:, 2].mean() == pytest.approx(0.75, abs=0.03)
    assert drawn[:, 0].mean() == pytest.approx(1.5, abs=0.1)
    assert not drawn[:, [1, 3]].any()  # the most likely choices, which count as certain
    expected = np.log([0.25 / CHOICES[0], 0.75 / CHOICES[0]])
    assert sorted(set(logs.round(4).tolist())) == pytest.approx(expected, abs=1e-3)


def test_advantages_end_where_races_end():
    rollout = np.zeros((16, 3), plan_shape([0]).rollout_type())
    rollout["rewards"] = 1.0
    rollout["active"] = True
    rollout["ended"][7] = True
    rollout["next_values"][7] = 5.0
    gains = advantages_of(rollout, np.zeros(3, np.float32), 0.9, 1.0)
    assert gains[7] == pytest.approx(1.0 + 0.9 * 5.0)
    assert gains[6] == pytest.approx(1.0 + 0.9 * (1.0 + 0.9 * 5.0))
    assert gains[-1] == pytest.approx(1.0)


def test_the_newest_policy_of_a_run_that_keeps_no_others_is_its_only_one(tmp_path):
    file = tmp_path / "policy.safetensors"
    save_weights(file, small_network())
    assert newest_policy(str(tmp_path)) == str(file)
    assert newest_policy(str(file)) == str(file)
    assert newest_policy("prior") == "prior"


@pytest.mark.slow
def test_time_ratios_of_saved_policies_are_kept_and_plotted(tmp_path, monkeypatch, capsys):
    run, kept = tmp_path / "first", tmp_path / "evaluations"
    run.mkdir()
    policies = [str(run / f"policy-{steps:09d}.safetensors") for steps in (20_000, 10_000)]
    for policy in policies:
        save_weights(policy, small_network())
    words = ["--form=P", "--numbers=1", "--track=lighthouse", f"--output={kept}"]
    monkeypatch.setenv("FORCE_COLOR", "1")  # a terminal, for the progress bar
    assert evaluate_main(["prior", *policies, *words]) == 0
    assert "6 races" in capsys.readouterr().err
    log = log_of(kept / "first")
    assert [line["kart_steps"] for line in log] == [10_000, 20_000]
    assert log[0]["time_ratio"] == log[1]["time_ratio"] > 0.5
    assert [path.name for path in kept.iterdir()] == ["first"]
    assert plot_main([str(kept / "first"), f"--output={tmp_path / 'curves.png'}"]) == 0
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")


def test_the_number_of_a_round_of_imitation_is_not_its_kart_steps(tmp_path):
    file = tmp_path / "policy-05.safetensors"
    save_weights(file, small_network())
    card = json.loads((export_policy(file, "clone", tmp_path / "clone") / "card.json").read_text())
    assert card["runs"][0]["kart_steps"] is None


def test_unknown_parameters_and_those_of_another_version_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"'best\.json' has no parameters of plans"):
        match_driver("prior:best.json")
    rules = asdict(DriverParameters()) | {"courage": 1.0}
    (tmp_path / "arguments.json").write_text(json.dumps([{"rules": rules}]))
    with pytest.raises(ConfigError, match="courage"):
        run_parameters(tmp_path / "policy.safetensors")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("--numbers=0", "numbers is 0"),
        ("--track=lighthous", "Did you mean 'lighthouse'"),
        ("--form=PBB", "form is 'PBB', expected P and A only"),
    ],
)
def test_invalid_arguments_of_a_comparison_are_reported(words, text, capsys):
    assert evaluate_main(["prior", words]) == 1
    assert text in capsys.readouterr().err
