"""The reference runs of the suite are trained, evaluated, saved once, and reported."""

import json
from dataclasses import replace

import pytest

from benchmarks.suite_reference import learning_curve, main, reference_keys, thinned
from stkzoo.agents.training.suite.learner import TaskArguments, TrainingMachine
from stkzoo.errors import ConfigError
from stkzoo.suite import TASKS, SuiteRun, load_runs

#: Arguments of the smallest run.
SMALL = {
    "hidden": (16, 16),
    "n_steps": 16,
    "n_epochs": 1,
    "batch_size": 32,
    "num_races": 2,
    "num_starts": 2,
    "actors": 1,
}


def test_runs_are_ordered_by_seed():
    keys = list(reference_keys(("versus", "team-2v2"), ("ippo", "mappo"), (0, 1)))
    assert [seed for _, _, seed in keys] == [0] * 4 + [1] * 4
    assert len(set(keys)) == 8


def test_self_play_has_no_runs_in_tasks_with_one_learner():
    keys = list(reference_keys(("versus", "team-2v2"), ("ippo", "fsp"), (0,)))
    assert keys == [("versus", "ippo", 0), ("team-2v2", "ippo", 0), ("team-2v2", "fsp", 0)]


def test_a_thinned_curve_keeps_its_ends():
    chosen = thinned(1000)
    assert len(chosen) == 100
    assert (chosen[0], chosen[-1]) == (0, 999)
    assert thinned(3) == [0, 1, 2]


def log_line(steps, **figures):
    return {"kart_steps": steps, "kart_steps_per_s": 50.0, **figures}


def test_a_learning_curve_has_the_time_of_all_iterations_and_ends_with_the_last():
    known = {"return": 3.0, "finished": 0.5, "position": 2.0}
    log = [log_line(100), *(log_line(100 * n, **known) for n in range(2, 1001))]
    curve = learning_curve(log)
    assert len(curve.kart_steps) == 100
    assert (curve.kart_steps[0], curve.kart_steps[-1]) == (100, 100_000)
    assert (curve.seconds[0], curve.seconds[-1]) == (2.0, 2000.0)
    assert curve.returns == (None, *[3.0] * 99)


@pytest.mark.slow
def test_a_small_run_is_trained_evaluated_and_written_once(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        "stkzoo.agents.training.suite.learner.TaskArguments",
        lambda **given: TaskArguments(**{**SMALL, **given}),
    )
    monkeypatch.setitem(TASKS, "solo-1", replace(TASKS["solo-1"], seeds=1))
    results, runs = tmp_path / "results", tmp_path / "runs"
    words = ["--tasks", "solo-1", "--algorithms", "ippo", "--seeds", "3", "--kart-steps", "100"]
    words += ["--runs", str(runs), "--output", str(results)]
    assert main([*words, "--only-evaluate"]) == 0
    assert "solo-1-ippo-3: is not trained" in capsys.readouterr().err
    trainer = TrainingMachine(64, {"torch": "2.11"})
    with monkeypatch.context() as patch:
        patch.setattr(TrainingMachine, "now", lambda: trainer)
        assert main(words) == 0
    (run,) = load_runs([results])
    assert (run.cores, run.versions) == (trainer.cores, trainer.versions)
    assert (run.name, run.budget) == ("solo-1-ippo-3", 100)
    assert run.kart_steps >= 100
    assert len(run.test.races) == len(run.train.races) == 2
    assert {race.track for race in run.test.races} == {"lighthouse"}
    assert run.training_seconds > 0
    before = (results / "solo-1-ippo-3.json").read_bytes()
    assert main(words) == 0
    assert "solo-1-ippo-3: has a result" in capsys.readouterr().err
    assert (results / "solo-1-ippo-3.json").read_bytes() == before
    (results / "solo-1-ippo-3.json").unlink()
    assert main(words) == 0  # evaluated again, on another machine
    written = json.loads((results / "solo-1-ippo-3.json").read_text())
    assert (written["cores"], written["versions"]) == (64, {"torch": "2.11"})
    (results / "solo-1-ippo-3.json").unlink()
    (runs / "solo-1-ippo-3").rename(runs / "solo-1-ippo-4")
    with pytest.raises(ConfigError, match="contains the run"):
        main([*words, "--seeds", "4", "--only-evaluate"])


def test_an_outdated_result_is_an_error(tmp_path):
    (tmp_path / "versus-ippo-0.json").write_text("{}")
    words = ["--tasks", "versus", "--algorithms", "ippo", "--seeds", "0"]
    with pytest.raises(ConfigError, match="has no suite run"):
        main([*words, "--output", str(tmp_path), "--only-evaluate"])
    assert SuiteRun.kind == "suite-run"
