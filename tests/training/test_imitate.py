"""Imitation learning from a teacher: behavior cloning and DAgger."""

import json

import numpy as np
import pytest

from stkzoo.agents.pretrained.mlp import load_driver
from stkzoo.agents.pretrained.weights import save_weights
from stkzoo.agents.training.export import export_policy
from stkzoo.agents.training.imitation import imitate
from stkzoo.agents.training.imitation.imitate import ImitationArguments, drive_race, main, run
from stkzoo.agents.training.imitation.lessons import Lesson, fit, held_out, mirrored
from stkzoo.agents.training.ppo.network import RacingNetwork
from stkzoo.race import run_race
from stkzoo.wrappers.racing import CHOICES, SIZE

torch = pytest.importorskip("torch")

SMALL = ImitationArguments(
    teacher="pursuit",
    rounds=1,
    tracks=("olivermath",),
    karts=1,
    hidden=(32,),
    n_epochs=2,
    jobs=1,
)


def examples(count=4000):
    """Returns examples in which the choices depend on the first numbers of the observations."""
    random = np.random.default_rng(1)
    observations = random.normal(size=(count, SIZE)).astype(np.float32)
    sides = observations[:, 3:8]
    actions = [
        np.digitize(sides[:, n], np.linspace(-1, 1, size - 1)) for n, size in enumerate(CHOICES)
    ]
    return observations, np.stack(actions, axis=1)


@pytest.mark.slow
def test_a_network_learns_choices_that_depend_on_its_observations():
    observations, actions = examples()
    network = RacingNetwork((64,), seed=0)
    how = {"learning_rate": 3e-3, "batch_size": 256, "seed": 0}
    out = held_out(len(actions), (0,))
    first = fit(network, observations, actions, out, n_epochs=1, **how)
    last = fit(network, observations, actions, out, n_epochs=10, **how)
    assert last["loss"] < 0.8 * first["loss"]
    assert last["accuracy"][2] > 0.7


def test_the_same_seed_gives_the_same_network():
    observations, actions = examples(600)
    trained = []
    for _ in range(2):
        network = RacingNetwork((16,), seed=3)
        how = {"n_epochs": 1, "learning_rate": 1e-3, "batch_size": 64, "seed": 3}
        fit(network, observations, actions, held_out(600, (3,)), **how)
        trained.append(network.policy_weights())
    for name, array in trained[0].items():
        np.testing.assert_array_equal(trained[1][name], array)


@pytest.mark.parametrize("count", [50, 20_000])
def test_some_examples_of_each_lesson_are_held_out(count):
    assert 0 < held_out(count, (1, 2)).sum() < 0.1 * count


def test_an_example_is_held_out_in_all_rounds_or_in_none(tmp_path, monkeypatch):
    found = []

    def record(network, observations, actions, is_held_out, **how):
        found.append(is_held_out)
        return fit(network, observations, actions, is_held_out, **how)

    def drive(_arguments, _folder, number, _report):
        return Lesson(*examples(500 + number), (1.0,), 1)

    monkeypatch.setattr(imitate, "fit", record)
    monkeypatch.setattr(imitate, "_drive_round", drive)
    small = {"hidden": (4,), "n_epochs": 1, "n_epochs_last": 1}
    arguments = ImitationArguments(teacher="pursuit", rounds=2, **small)
    run(arguments, tmp_path)
    assert [len(each) for each in found] == [500, 1001, 1503]
    np.testing.assert_array_equal(found[1][:500], found[0])
    np.testing.assert_array_equal(found[2][:1001], found[1])


def test_a_mirrored_example_steers_to_the_other_side():
    observations, actions = examples(50)
    there = mirrored(observations, actions)
    np.testing.assert_array_equal(there[1][:, 0], 20 - actions[:, 0])
    np.testing.assert_array_equal(there[1][:, 1:], actions[:, 1:])
    back = mirrored(*there)
    np.testing.assert_array_equal(back[0], observations)
    np.testing.assert_array_equal(back[1], actions)


@pytest.fixture(scope="module")
def imitated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("imitate")
    return folder, run(SMALL, folder)


@pytest.mark.slow
def test_a_run_clones_drives_and_learns_from_the_teachers_labels(imitated):
    folder, log = imitated
    assert [line["driver"] for line in log] == ["pursuit", "behavior cloning", "DAgger, round 1"]
    assert log[0]["finished"] == 1.0
    assert log[1]["examples"] > log[0]["examples"]
    assert all(0.5 < line["time_ratio"] <= 2.0 for line in log)
    assert [json.loads(text) for text in (folder / "log.jsonl").read_text().splitlines()] == log


@pytest.mark.slow
def test_the_clone_drives_in_the_rounds_as_its_agent_does(tmp_path, monkeypatch):
    """The network always turns left at full throttle; the agent's filter frees the stuck kart."""
    found = []

    def run_for_a_while(*drivers, **options):
        found.append(run_race(*drivers, **options | {"max_steps": 150}))
        return found[-1]

    network = RacingNetwork((4,), seed=0)
    with torch.no_grad():
        network.policy[-1].weight[:] = 0.0
        network.policy[-1].bias[:] = -torch.arange(float(sum(CHOICES)))
    policy = tmp_path / "policy.safetensors"
    save_weights(policy, network.policy_weights())
    monkeypatch.setattr(imitate, "run_race", run_for_a_while)
    drive_race("pursuit", str(policy), 1, 3, "olivermath", 1)
    agent = export_policy(policy, "left", tmp_path / "agent")
    options = {"track": "olivermath", "seed": 1, "difficulty": 3, "inline": True}
    run_for_a_while([str(agent)], **options)
    assert found[0].difficulty == 3
    clone, agent = (result.agents[0] for result in found)
    assert clone.distance == agent.distance


@pytest.mark.slow
def test_repeating_a_finished_run_drives_no_races(imitated):
    folder, log = imitated
    lessons = sorted(folder.glob("lessons-*.safetensors"))
    assert len(lessons) == 3
    before = [path.stat().st_mtime_ns for path in lessons]
    assert run(SMALL, folder) == log
    assert [path.stat().st_mtime_ns for path in lessons] == before


@pytest.mark.slow
def test_the_policy_races_and_can_start_self_play(imitated):
    folder, _ = imitated
    driver = load_driver(folder / "policy.safetensors")
    assert driver.best(np.zeros((3, SIZE), np.float32)).shape == (3, 5)
    result = run_race([str(folder / "agent")], track="olivermath", max_steps=30, inline=True)
    assert not result.has_errors
    assert result.agents[0].driver == "student"


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--teacher", "ai"], "ai cannot label what a learner sees"),
        (["--teacher", "planner"], "planner cannot label what a learner sees"),
        (["--teacher", "nobody"], "unknown driver"),
        (["--karts", "0"], "karts is 0"),
    ],
)
def test_invalid_arguments_are_reported(words, text, tmp_path, capsys):
    assert main(["--output", str(tmp_path / "run"), *words]) == 1
    assert text in capsys.readouterr().err


def test_the_games_ai_can_be_cloned_without_rounds_of_labels():
    assert ImitationArguments(teacher="ai", rounds=0).rounds == 0
