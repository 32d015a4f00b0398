"""The reference algorithms of the suite learn, resume, and write agents that race."""

from contextlib import ExitStack, closing

import numpy as np
import pytest

from stkzoo import RaceVectorEnv
from stkzoo.agents.planning.memory import MEMORY_MIRROR, MEMORY_SIZE
from stkzoo.agents.planning.mirrored import MirroredRaces
from stkzoo.agents.pretrained.policy import Network
from stkzoo.agents.pretrained.weights import save_weights
from stkzoo.agents.training.common.actors import SharedArray
from stkzoo.agents.training.common.filtered import FilteredView
from stkzoo.agents.training.ppo.network import RacingNetwork
from stkzoo.agents.training.ppo.opponents import Matchmaker
from stkzoo.agents.training.ppo.rollouts import ActorArguments, RaceActor, values_of
from stkzoo.agents.training.ppo.run import PPORun
from stkzoo.agents.training.suite.algorithms import TaskArguments, task_setup
from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.race import run_race
from stkzoo.suite import find_task
from stkzoo.wrappers.racing import CONTEST_MIRROR, CONTEST_SIZE, PLACES, SIZE

TRAIN = "suite", "train", "solo-general", "ippo"
SMALL = {
    "task": "solo-general",
    "hidden": (16, 16),
    "n_steps": 16,
    "keep_every": 32,
    "n_epochs": 2,
    "batch_size": 32,
    "num_races": 2,
    "random_starts": 0.0,
    "num_starts": 2,
    "actors": 1,
    "checkpoint_every": 2,
    "anneal_timesteps": 1000,
}


def small_run(folder, algorithm="ippo", **changes):
    arguments = TaskArguments(**{**SMALL, "algorithm": algorithm, **changes})
    return PPORun(folder, arguments, task_setup(arguments))


def actor_of(folder, algorithm, task, steps, **options):
    """Returns an actor that drives one race of a task, its rollouts and new networks."""
    arguments = TaskArguments(**{**SMALL, "algorithm": algorithm, "task": task, "num_races": 1})
    setup = task_setup(arguments, num_starts=1, **options)
    network = setup.make_network()
    memory = SharedArray((2, steps, setup.groups[0].num_agents), network.shape.rollout_type())
    own = ActorArguments(
        setup.groups, network.shape, None, folder, bootstraps_finish=False, hold=setup.hold
    )
    return RaceActor(own, memory), memory.array()[0], network


def iterate(learner, count):
    for _ in range(count):
        learner.iterate()
        learner.save_policy()
        if learner.is_checkpoint(learner.iteration):
            learner.save_checkpoint()
            learner.begin_races()


def arrays_of(learner):
    policy, critic = learner.network.weights()
    return {**{f"policy {n}": a for n, a in policy.items()}, **critic}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "task", "actors"),
    [
        ("ippo", "solo-general", 2),
        pytest.param("mappo", "team-2v2", 1, marks=pytest.mark.matrix),
        pytest.param("pfsp", "selfplay-5", 1, marks=pytest.mark.matrix),
        pytest.param("recurrent", "versus", 1, marks=pytest.mark.matrix),
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
def test_an_interrupted_run_loses_the_policies_after_its_checkpoint(tmp_path):
    learner = small_run(tmp_path)
    iterate(learner, 3)
    learner.close()
    kept = sorted(tmp_path.glob("policy-*"))
    small_run(tmp_path).close()
    assert sorted(tmp_path.glob("policy-*")) == kept[:2] != kept
    with pytest.raises(ConfigError, match="n_steps was 16, now 8"):
        small_run(tmp_path, n_steps=8)


def test_a_rollout_has_shared_rewards_and_the_learners_own_values(tmp_path):
    actor, rollout, network = actor_of(tmp_path, "mappo", "team-2v2", 40)
    blind, blind_rollout, blind_network = actor_of(tmp_path, "blind", "team-2v2", 1)
    try:
        actor.begin([5]), blind.begin([5])
        driven = actor.drive(0, *network.weights(), {})
        blind.drive(0, *blind_network.weights(), {})
    finally:
        actor.close(), blind.close()
    assert rollout["active"].all()
    size, own = CONTEST_SIZE + MEMORY_SIZE, PLACES["line_position"].start
    others, ranks = rollout["state"].reshape(40, 4, 3, own), rollout["inputs"][..., SIZE]
    for step, slot, mate in ((0, 0, 1), (20, 1, 0), (39, 3, 2)):
        rivals = sorted({0, 1, 2, 3} - {slot, mate}, key=ranks[step].__getitem__)
        seen = rollout["inputs"][step, [mate, *rivals], :own]
        assert (others[step, slot] == seen).all()
    assert rollout["inputs"].shape[2] == size
    flags = np.s_[CONTEST_SIZE - 28 : CONTEST_SIZE : 9]
    assert (rollout["inputs"][..., flags].sum(axis=2) == 1).all()
    assert not blind_rollout["inputs"][..., flags].any()
    first = blind_network.policy_weights()["mlp_extractor.policy_net.0.weight"]
    assert not first[:, flags].any()
    assert first[:, flags.start - 1].any()
    assert not rollout["ended"].any()
    assert driven.finishes == []
    assert (rollout["rewards"][:, 0] == rollout["rewards"][:, 1]).all()
    assert (rollout["rewards"][:, 2] == rollout["rewards"][:, 3]).all()
    assert (rollout["rewards"][:, 0] != rollout["rewards"][:, 2]).any()
    check_evaluation(network, rollout[3])


def check_evaluation(network, rows):
    """Checks that the network in PyTorch agrees with the actor that drove the rows."""
    inputs, *columns = network.tensors(rows)
    every = network.torch.arange(len(rows))
    inputs = network.chosen_inputs(inputs, every, every >= 0)
    log_probability, entropy, _, values = network.evaluate([inputs, *columns])
    assert np.allclose(log_probability.detach().numpy(), rows["log_probability"], atol=1e-4)
    assert np.allclose(values.detach().numpy() * 10.0, rows["values"], atol=1e-4)
    assert (entropy > 0).all()


def test_a_recurrent_policy_remembers_until_its_race_ends(tmp_path):
    """Step 39 ends all races in the middle of a sequence, and their memory is lost."""
    actor, rollout, network = actor_of(tmp_path, "recurrent", "selfplay-5", 64, max_cycles=40)
    try:
        actor.begin([5])
        actor.drive(0, *network.weights(), {})
    finally:
        actor.close()
    size = network.shape.memory_size
    begins = ~rollout["inputs"][..., -size:].any(axis=2)
    assert rollout["ended"][39].all()
    assert begins[40].all()
    assert not begins[30:40].any()
    sequences = rollout.reshape(4, 16, 5).swapaxes(1, 2).reshape(20, 16)
    check_evaluation(network, sequences.reshape(-1))
    sequences["inputs"][12, 4, 0] += 1.0
    (inputs, *_), before = network.tensors(sequences), sequences["inputs"][..., -size:]
    apart = (network._remembered(inputs).detach().numpy()[..., -size:] - before)[12]
    assert (np.abs(apart).max(axis=1) > 1e-5).tolist() == [False] * 4 + [True] * 4 + [False] * 8


def test_a_kart_that_has_finished_shares_the_later_rewards_of_its_mate(tmp_path):
    """Kart 0 has finished, so it waits while kart 1 drives on."""
    actor, _, _ = actor_of(tmp_path, "ippo", "team-2v2", 8)
    (part,) = actor._parts
    nobody, first, second = np.zeros(4, np.bool_), *np.eye(4, dtype=np.bool_)[:2]
    try:
        part._racing = np.ones(4, np.bool_)
        assert not part._end_teams(first, nobody).any()
        assert part._waits.tolist() == [[True, False, False, False]]
        part._racing = ~first
        assert not part._end_teams(nobody, nobody).any()
        assert part._end_teams(second, nobody).tolist() == [True, True, False, False]
        assert not part._waits.any()
        part._racing = ~(first | second)
        assert part._end_teams(nobody, ~(first | second)).tolist() == [False, False, True, True]
    finally:
        actor.close()


def test_a_mirrored_kart_sees_and_drives_the_mirror_image():
    """Two equal races, one of them mirrored, also after they have started again."""
    mirror = np.concatenate([CONTEST_MIRROR, MEMORY_MIRROR])
    options = {"num_kart": 3, "agents": 2, "track": "lighthouse", "view": "contest"}
    with ExitStack() as resources:
        plain, mirrored = (
            MirroredRaces(
                resources.enter_context(closing(RaceVectorEnv(1, **options, max_cycles=25))),
                FilteredView(2, 11),
                share,
            )
            for share in (0.0, 1.0)
        )
        plain.reset(seed=4), mirrored.reset(seed=4)
        random = np.random.default_rng(0)
        for _ in range(60):
            choices = np.column_stack([random.integers(0, n, 2) for n in (21, 2, 2, 2, 2)])
            image = choices.copy()
            image[:, 0] = 20 - choices[:, 0]
            plain.step_async(choices), mirrored.step_async(image)
            seen, *_, infos = plain.step_wait()
            other, *_, other_infos = mirrored.step_wait()
            if "final_obs" in infos:
                last, other_last = (np.stack(i["final_obs"]) for i in (infos, other_infos))
                np.testing.assert_allclose(other_last, last * mirror, atol=1e-6)
            np.testing.assert_allclose(other, seen * mirror, atol=1e-6)


def test_normalizing_returns_keeps_the_values(tmp_path):
    _, rollout, network = parts = actor_of(tmp_path, "ippo", "solo-general", 4)
    parts[0].close()
    rollout["inputs"] = np.random.default_rng(0).normal(size=rollout["inputs"].shape)
    before = values_of(Network(network.weights()[1]), rollout[0])
    for returns in ([3.0, 40.0], [-2.0, -2.1]):
        network.normalize_returns(np.array(returns, np.float32))
    assert network.returns.tolist() != [0.0, 10.0]
    after = values_of(Network(network.weights()[1]), rollout[0])
    np.testing.assert_allclose(after, before, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_the_command_trains_an_agent_that_races(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        "stkzoo.agents.training.suite.algorithms.TaskArguments",
        lambda **given: TaskArguments(**{**SMALL, "checkpoint_every": 100, **given}),
    )
    words = [
        "suite",
        "train",
        "solo-general",
        "ippo",
        "--kart-steps",
        "100",
        "--output",
        str(tmp_path),
    ]
    assert main(words) == 0
    assert f"stkzoo suite evaluate solo-general {tmp_path / 'agent'}" in capsys.readouterr().out
    result = run_race([str(tmp_path / "agent")], track="lighthouse", max_steps=20, inline=True)
    assert not result.has_errors
    assert result.agents[0].driver == "ippo_solo_general_0"
    assert main(words) == 0  # the run is already complete


def test_self_play_is_refused_for_one_learner(tmp_path):
    with pytest.raises(ConfigError, match="pfsp needs several learners, which solo-general"):
        small_run(tmp_path, "pfsp")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["team-2v2", "selfplay-5"])
def test_a_past_policy_drives_a_team_or_two_karts_and_is_not_learned_from(tmp_path, name):
    task = find_task(name)
    actor, rollout, network = actor_of(tmp_path, "pfsp", name, 400, max_cycles=60)
    save_weights(
        tmp_path / "past.safetensors",
        RacingNetwork((8, 8), 1, network.shape.inputs).policy_weights(),
    )
    actor.begin([5])
    try:
        driven = actor.drive(0, *network.weights(), {"": 0.5, "past": 0.5})
    finally:
        actor.close()
    ends = np.flatnonzero(rollout["active"].any(axis=1) & rollout["ended"].any(axis=1)) + 1
    races = np.split(rollout, ends)
    learned = [tuple(np.flatnonzero(race["active"].any(axis=0))) for race in races]
    counts = {len(slots) for slots in learned}
    assert counts == {task.learners, task.learners - task.learners // 2}
    if task.teams:
        assert {*learned} - {(0, 1, 2, 3)} <= {(0, 1), (2, 3)}
    assert driven.duels
    assert all(who == "past" and 0 <= beaten <= 1 for who, beaten in driven.duels)
    assert len(driven.finishes) < task.learners * (len(races) - 1)


def test_prioritized_self_play_meets_the_hardest_rivals_most_often():
    odds = {}
    for kind in ("prioritized", "fictitious", "none"):
        matchmaker = Matchmaker(kind)
        for name in ("strong", "weak"):
            matchmaker.add(name)
        for _ in range(50):
            matchmaker.update("strong", 0.0)
            matchmaker.update("weak", 1.0)
        odds[kind] = matchmaker.odds()
    assert odds["prioritized"]["strong"] > 0.45
    assert odds["prioritized"]["weak"] > 0
    assert sum(odds["prioritized"].values()) == pytest.approx(1)
    assert odds["fictitious"] == {"": 0.5, "strong": 0.25, "weak": 0.25}
    assert odds["none"] == {}


def test_an_unknown_algorithm_is_refused(capsys):
    assert main(["suite", "train", "solo-general", "ipo"]) == 2
    assert "unknown algorithm 'ipo'. Did you mean 'ippo'?" in capsys.readouterr().err


def test_unusable_arguments_are_refused(tmp_path, capsys):
    file, run = tmp_path / "file", tmp_path / "run"
    file.touch()
    assert main([*TRAIN, "--seed", "1" * 22, "--output", str(run)]) == 2
    assert "expected a whole number from 0 to" in capsys.readouterr().err
    assert not run.exists()
    assert main([*TRAIN, "--output", str(file)]) == 2
    error = capsys.readouterr().err
    assert f"the run's folder {file} cannot be used: " in error
    assert "choose another --output" in error
