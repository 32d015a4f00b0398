"""Reports of runs: numbers, files and invalid results."""

import json
import sys
from dataclasses import replace

import pytest

from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.suite import TASKS, SuiteReport, SuiteRun, load_runs, make_report, write_suite_report
from stkzoo.suite.report.document import NORMALIZED
from stkzoo.suite.report.writing import report_sections
from stkzoo.suite.scores import scale_ends
from tests.support.suite_runs import suite_run, write_run

FILES = {"report.json", "report.md", "marl_eval.json", "scores.svg", "profiles.svg"}


def constant(value):
    return lambda *_: value


@pytest.fixture
def two_runs(tmp_path):
    """Writes the files of two runs."""
    return [write_run(tmp_path, suite_run("versus", "ippo", seed)) for seed in (0, 1)]


# ------------------------------------------------------------------ numbers


def test_scores_are_on_the_scale_of_the_baselines():
    weakest, strongest = scale_ends("versus")
    value = (weakest + strongest) / 2
    report = make_report([suite_run("versus", "ippo", 0, constant(value))])
    (task,) = report.tasks
    (own,) = task.algorithms
    assert task.scale == NORMALIZED
    assert own.score.value == pytest.approx(value)
    assert own.iqm.value == pytest.approx(0.5)
    assert own.gap.value == pytest.approx(0.0)
    assert own.seeds == (0,)


def test_a_task_without_baselines_has_the_metric_as_its_scale(monkeypatch):
    monkeypatch.setattr(
        "stkzoo.suite.scores.Baselines.has", lambda _, task: task in ("versus", "team-2v2")
    )
    runs = [suite_run(task, "ippo", 0, constant(0.5)) for task in ("selfplay-5", "versus")]
    runs.append(suite_run("solo-1", "ippo", 0, constant(1.2)))
    found = {task.task: task for task in make_report(runs).tasks}
    assert found["selfplay-5"].scale == "beaten"
    assert found["selfplay-5"].algorithms[0].iqm.value == pytest.approx(0.5)
    assert found["solo-1"].scale == "time_ratio"
    assert found["solo-1"].algorithms[0].iqm.value == pytest.approx(-1.2)
    text = report_sections(make_report(runs), {})
    assert "`solo-1`, `selfplay-5`: the baselines have not been measured" in text


def test_the_gap_is_positive_if_training_tracks_have_better_scores():
    tracks = set(TASKS["versus"].test_tracks)
    runs = [
        suite_run("versus", "ippo", seed, lambda track, *_: 0.25 if track in tracks else 0.5)
        for seed in (0, 1)
    ]
    (task,) = make_report(runs).tasks
    (own,) = task.algorithms
    weakest, strongest = scale_ends("versus")
    assert own.gap.value == pytest.approx(0.25 / (strongest - weakest))
    assert (own.score.value, own.train_score.value) == (0.25, 0.5)


# ------------------------------------------------------------------ files


@pytest.mark.slow
def test_a_report_has_all_its_files_and_is_reproducible(two_runs, tmp_path, capsys):
    one, two = tmp_path / "one", tmp_path / "two"
    assert main(["suite", "report", *map(str, two_runs), "--output", str(one)]) == 0
    assert f"Wrote the report of 2 runs to {one / 'report.md'}" in capsys.readouterr().out
    write_suite_report([tmp_path], two)
    names = {file.name for file in one.iterdir()}
    assert names == FILES | {"learning_curves.svg"}  # a single algorithm has no comparison
    for name in names:
        assert (one / name).read_bytes() == (two / name).read_bytes(), name
    report = SuiteReport.load(one / "report.json")
    assert report == make_report(load_runs(two_runs))
    assert "| versus | ippo | beaten | 2 |" in (one / "report.md").read_text()


def test_a_run_that_fails_on_one_track_makes_the_interval_wide():
    """Both directions of a track fail together, so a draw without the track has no failure."""

    def failing(track, *_):
        return 3.0 if track == "zengarden" else 1.0

    runs = [suite_run("solo-general", "ippo", seed, failing) for seed in (0, 1)]
    ((own,),) = (task.algorithms for task in make_report(runs).tasks)
    assert own.score.interval == pytest.approx((1.0, 2.2))  # from no draw to three of five


def test_a_folder_of_results_cannot_be_the_folder_of_the_report(two_runs, tmp_path, capsys):
    (tmp_path / "link").symlink_to(tmp_path)
    assert main(["suite", "report", str(tmp_path), "--output", str(tmp_path / "link")]) == 2
    assert "link has the results, and the next report would" in capsys.readouterr().err
    assert {*tmp_path.glob("*.json")} == {*two_runs}


@pytest.mark.slow
def test_two_algorithms_are_compared(tmp_path):
    for name in ("ippo", "mappo"):
        write_run(tmp_path, suite_run("versus", name, 0))
    write_suite_report([tmp_path], tmp_path / "report")
    assert (tmp_path / "report" / "improvement.svg").exists()
    assert "| versus | ippo | mappo |" in (tmp_path / "report" / "report.md").read_text()


def test_a_run_without_completed_races_has_no_learning_curve(tmp_path):
    run = suite_run("versus", "ippo", 0)
    nothing = (None,) * len(run.curve.kart_steps)
    curve = replace(run.curve, returns=nothing, finished=nothing, position=nothing)
    write_run(tmp_path, replace(run, curve=curve))
    write_suite_report([tmp_path], tmp_path / "report")
    assert {file.name for file in (tmp_path / "report").iterdir()} == FILES


@pytest.mark.slow
def test_marl_eval_gets_each_run_with_equal_steps_and_metrics(tmp_path):
    runs = [write_run(tmp_path, suite_run("versus", "ippo", seed)) for seed in (0, 1)]
    write_suite_report(runs, tmp_path / "report")
    found = json.loads((tmp_path / "report" / "marl_eval.json").read_text())
    assert list(found) == ["stkzoo-suite-1", "stkzoo-suite-1-training"]
    for environment, metrics in zip(
        found.values(), ({"score"}, {"return", "finished", "position"}), strict=True
    ):
        own = environment["versus"]["ippo"]
        assert list(own) == ["seed_0", "seed_1"]
        for steps in own.values():
            assert set(steps["absolute_metrics"]) == metrics
            counts = [step["step_count"] for name, step in steps.items() if "step_" in name]
            assert counts == sorted(counts)
            assert all(set(step) - {"step_count"} == metrics for step in steps.values())
            assert list(steps)[:-1] == [f"step_{n}" for n in range(len(counts))]
    score = found["stkzoo-suite-1"]["versus"]["ippo"]["seed_0"]["absolute_metrics"]["score"]
    assert len(score) == TASKS["versus"].num_races


def test_a_missing_library_is_named(two_runs, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert main(["suite", "report", str(two_runs[0]), "--output", str(tmp_path / "report")]) == 2
    assert (
        "the plot needs matplotlib (extra report), which is not installed"
        in capsys.readouterr().err
    )


# ------------------------------------------------------------------ invalid results


def changed(file, **changes):
    file.write_text(json.dumps({**json.loads(file.read_text()), **changes}))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"type": "suite-entry"}, "expected a suite-run of version 1"),
        ({"suite": "stkzoo-suite-0"}, "the suite is 'stkzoo-suite-0', expected stkzoo-suite-1"),
        ({"task": "verus"}, "versus"),
        ({"task_digest": "0" * 64}, "another definition of versus"),
        ({"algorithm": "a | b"}, "$.algorithm"),
        ({"kart_steps": 200_000_000}, "and the curve ends at 2,000,000; expected the same"),
        ({"budget": 2_000_001}, "kart_steps is 2,000,000, expected 2,000,001 (the budget) to"),
        ({"budget": 1_899_999}, "expected 1,899,999 (the budget) to 1,999,999; end the training"),
    ],
)
def test_an_invalid_field_is_an_error_that_names_the_file(two_runs, changes, text):
    changed(two_runs[0], **changes)
    with pytest.raises(ConfigError) as caught:
        load_runs(two_runs)
    assert str(two_runs[0]) in str(caught.value)
    assert text in str(caught.value)


def with_races(file, change):
    test = json.loads(file.read_text())["test"]
    change(test)
    changed(file, test=test)


def test_a_missing_race_is_refused(two_runs):
    with_races(two_runs[0], lambda test: test["races"].pop())
    with pytest.raises(ConfigError, match="test has 9 races of zengarden reversed PAAAA, expected"):
        load_runs(two_runs)


def test_a_score_that_does_not_follow_from_the_races_is_refused(two_runs):
    with_races(two_runs[0], lambda test: test["score"].update(value=0.99))
    with pytest.raises(ConfigError, match=r"test has the score 0\.99; its races give"):
        load_runs(two_runs)


def test_a_time_ratio_above_the_time_limit_is_refused(tmp_path):
    file = write_run(tmp_path, suite_run("solo-1", "ippo", 0))
    with_races(file, lambda test: test["races"][0].update(value=3.5))
    with pytest.raises(ConfigError, match=r"test has a race with time_ratio 3\.5, expected <= 3"):
        load_runs([file])


def test_the_same_run_twice_is_refused(two_runs, tmp_path):
    copy = tmp_path / "copy.json"
    copy.write_bytes(two_runs[0].read_bytes())
    with pytest.raises(ConfigError, match="are the same run, versus-ippo-0"):
        load_runs([two_runs[0], copy])


def test_runs_with_different_budgets_are_refused(two_runs):
    changed(two_runs[1], budget=1_950_000)
    with pytest.raises(ConfigError, match="write a report for each budget"):
        load_runs(two_runs)


def test_a_result_survives_its_file(two_runs):
    run = suite_run("versus", "ippo", 0)
    assert SuiteRun.load(two_runs[0]) == run
    assert len(two_runs[0].read_bytes()) < 60_000
