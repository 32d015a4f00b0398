"""Distillation of plans into one network."""

import json
from contextlib import closing

import numpy as np
import pytest

from stkzoo.agents.planning.driver import PolicyInput
from stkzoo.agents.pretrained.action_filter import INPUT_SIZE
from stkzoo.agents.pretrained.mlp import load_driver
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.agents.training.common.matches import match_driver
from stkzoo.agents.training.evaluate import evaluate
from stkzoo.agents.training.imitation import distill
from stkzoo.wrappers.racing import CHOICES

SMALL = distill.DistillationArguments(
    rounds=1,
    steps=300,
    tracks=("olivermath",),
    hidden=(16, 16),
    n_epochs=1,
    n_epochs_last=1,
    batch_size=64,
)


@pytest.fixture
def races():
    with closing(distill._races(SMALL, 1, 0, 1)) as races:
        yield races


def test_labels_from_the_plans_drive_like_the_plans(races):
    plans, race = RacingPolicy.of_plans_alone(), races.races.races[0]
    observations, _ = races.reset(seed=0)
    for _ in range(120):
        observations, *_ = races.step(plans.best(PolicyInput(**observations)))
    there = float(race.snapshot.karts["overall_distance"][0])
    lesson = distill.LabelledRaces(races, seed=0)
    drifted = 0
    for _ in range(120):
        answers = lesson.labels()
        assert answers.shape == (1, len(CHOICES))
        assert lesson.seen.shape == (1, INPUT_SIZE)
        drifted += int(answers[0, 2])
        lesson.step(answers)
    assert there > 200
    assert float(race.snapshot.karts["overall_distance"][0]) == pytest.approx(there, rel=0.1)
    assert drifted > 20


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("distil")
    return folder, distill.run(SMALL, folder)


@pytest.mark.slow
def test_a_run_drives_by_plans_then_by_the_network(run):
    folder, log = run
    assert [line["driver"] for line in log] == ["the plans", "behavior cloning"]
    assert [line["examples"] for line in log] == pytest.approx([300, 600], abs=60)
    assert log[1]["loss"] < log[0]["loss"]
    assert [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()] == log
    driver = load_driver(folder / "policy.safetensors")
    assert (driver.inputs, driver.hold) == (INPUT_SIZE, 1)


@pytest.mark.slow
def test_the_network_is_compared_with_the_plans_in_the_same_races(run):
    folder, log = run
    drivers = [match_driver(folder / "policy.safetensors"), match_driver("prior")]
    # Repeat the races of the last log entry.
    network, plans = evaluate(drivers, SMALL.tracks, 1, bots=0, first_number=0)
    ratios = [min(finish.counted_ratio, distill._UNFINISHED) for (finish,) in network]
    assert np.mean(ratios) == pytest.approx(log[-1]["time_ratio_alone"], abs=1e-4)
    assert sum(finish.ratio is None for (finish,) in network) == log[-1]["unfinished"]
    assert np.mean([finish.counted_ratio for (finish,) in plans]) < 1.0


@pytest.mark.matrix
def test_a_killed_run_resumes_with_its_round(run, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        calls = iter([distill._alone])

        def alone(*arguments):
            return next(calls)(*arguments)

        patch.setattr(distill, "_alone", alone)
        with pytest.raises(StopIteration):
            distill.run(SMALL, tmp_path)
    assert len((tmp_path / "log.jsonl").read_text().splitlines()) == 1
    folder, log = run
    assert distill.run(SMALL, tmp_path) == log
    ours, theirs = (load_weights(f / "policy.safetensors") for f in (tmp_path, folder))
    assert all((ours[name] == theirs[name]).all() for name in theirs)
