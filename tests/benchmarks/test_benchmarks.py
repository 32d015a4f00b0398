"""The benchmark commands run and save their measurements. Speeds are not checked."""

import argparse
import importlib
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks import bench_charts, bench_steps, bench_tables, opponents
from benchmarks.bench_all import BENCHMARKS
from benchmarks.bench_common import VIEWS, Table, figures, quantiles
from benchmarks.bench_controls import (
    RandomControls,
    RecordedControls,
    controls_of,
    driving_style,
    to_action,
)
from benchmarks.bench_driver import (
    Contender,
    Spec,
    contenders,
    race_together,
    record_controls,
)
from benchmarks.bench_memory import children, processes
from benchmarks.bench_steps import GROUPS, matches
from benchmarks.learned_drivers import NAMES, PARTS, cost
from stkzoo import race_v0
from stkzoo.views import VIEWS as VIEWS_OF_STKZOO
from tests.support.generic_env import kart_env
from tests.support.paths import ROOT

PHYSICAL_VIEWS = ("control", "flattened_control")


def run(name, *arguments):
    command = [sys.executable, "-m", f"benchmarks.bench_{name}", *map(str, arguments)]
    # The reference compiles its rotations in each process; short runs are faster without.
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    return subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300
    )


def processes_below(pid):
    below = children(pid)
    return [pid, *below, *(grandchild for child in below for grandchild in children(child))]


def wait_until_gone(pids):
    """Waits up to 10 s; returns the processes that still run. Zombies do not count."""
    for _ in range(200):
        living = [pid for pid in pids if is_alive(pid)]
        if not living:
            return []
        time.sleep(0.05)
    return living


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    """Runs all benchmarks briefly; returns the folder with the results, and the ended process."""
    folder = tmp_path_factory.mktemp("trial")
    return folder, run("all", "--quick", "--output", folder)


def test_a_short_run_of_all_benchmarks_succeeds(trial):
    _, ended = trial
    assert (ended.returncode, ended.stderr[-2000:] if ended.returncode else "") == (0, "")


@pytest.mark.parametrize("name", BENCHMARKS)
def test_a_result_has_command_host_and_settings(trial, name):
    report = json.loads((trial[0] / f"{name}.json").read_text())
    assert report["command"].startswith(f"python -m benchmarks.bench_{name} --steps ")
    assert report["host"]["packages"]["PySuperTuxKart2"]
    assert report["settings"]["karts"]
    assert len(report["results"]) > 0


def test_a_saved_command_can_be_repeated(trial, tmp_path):
    command = json.loads((trial[0] / "resets.json").read_text())["command"].split()
    again = run("resets", *command[3:], "--output", tmp_path / "again.json")
    assert again.returncode == 0
    report = json.loads((tmp_path / "again.json").read_text())
    assert report["command"].split() == command


def test_results_contain_no_paths(trial):
    for path in trial[0].glob("*.json"):
        report = json.loads(path.read_text())
        text = report["command"] + json.dumps(report["host"]) + json.dumps(report["settings"])
        assert "/" not in text


@pytest.mark.parametrize("name", ["steps", "transport", "scaling"])
def test_all_contenders_drove_the_same_race(trial, name):
    results = json.loads((trial[0] / f"{name}.json").read_text())["results"]
    assert [result["same_race"] for result in results] == [True] * len(results)


def test_all_five_contenders_are_compared(trial):
    results = json.loads((trial[0] / "steps.json").read_text())["results"]
    by_group = {result["group"]: set(result["contenders"]) for result in results}
    ours = {"engine", "stkzoo, in process", "stkzoo, worker"}
    theirs = {"reference, in process", "reference, subprocess"}
    assert by_group == {
        "parallel": ours | {"stkzoo, events"},
        "multi": ours | theirs,
        "single": ours | theirs,
    }


def test_every_view_without_images_is_measured():
    assert set(VIEWS) == set(VIEWS_OF_STKZOO)


def test_every_contender_reports_the_time_in_the_engine(trial):
    results = json.loads((trial[0] / "steps.json").read_text())["results"]
    for result in results:
        for found in result["contenders"].values():
            assert 0 < found["engine"]["median"] < found["step"]["p90"]


def test_a_profile_lists_functions_and_is_saved_as_text(trial):
    text = (trial[0] / "profile.txt").read_text()
    assert "tottime" in text
    assert "== flattened, 2 karts, in process" in text
    assert "== flattened, 2 karts, worker" in text


def test_the_page_is_written_from_the_results(trial, tmp_path):
    page = tmp_path / "page.md"
    assert bench_tables.main(["--results", str(trial[0]), "--output", str(page)]) == 0
    text = page.read_text()
    assert "python -m benchmarks.bench_steps --steps 10" in text
    assert text.count("| --: |") > 5
    assert "stkzoo, worker" in text


def test_the_charts_show_the_saved_results(tmp_path):
    assert bench_charts.main(["--output", str(tmp_path)]) == 0
    saved = ROOT / "docs" / "images" / "benchmarks"
    for name in bench_charts.CHARTS:
        drawn = (tmp_path / f"{name}.svg").read_text()
        assert labels(drawn) == labels((saved / f"{name}.svg").read_text()) != []


def labels(svg):
    return re.findall("<!-- (.*?) -->", svg)


def test_the_page_needs_results(tmp_path, capsys):
    with pytest.raises(SystemExit):
        bench_tables.main(["--results", str(tmp_path)])
    assert "run make bench" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["all", "tables", *BENCHMARKS])
def test_every_command_has_help(name, capsys):
    command = importlib.import_module(f"benchmarks.bench_{name}")
    with pytest.raises(SystemExit, match="0"):
        command.main(["--help"])
    assert f"python -m benchmarks.bench_{name}" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [["--steps", "0"], ["--karts", "-1"], ["--cores", "-1"]])
def test_too_small_sizes_are_refused(arguments, capsys):
    with pytest.raises(SystemExit, match="2"):
        bench_steps.main(arguments)
    assert "is less than" in capsys.readouterr().err


def test_the_reference_runs_the_same_race_bit_for_bit():
    specs = {
        "engine": Spec("bare", num_kart=2, num_agents=2),
        "stkzoo": Spec("stkzoo", "multi", num_kart=2, num_agents=2),
        "reference": Spec("reference", "multi", num_kart=2, num_agents=2, subprocess=True),
    }
    with contenders(specs) as started:
        times, is_same = race_together(started, track="olivermath", steps=30, block=7)
    assert is_same
    assert [len(times[name]["total"]) for name in specs] == [30, 30, 30]


def test_a_different_race_is_detected():
    specs = {
        "one": Spec("bare", num_kart=2, num_agents=2),
        "other": Spec("bare", num_kart=3, num_agents=2),
    }
    with contenders(specs) as started:
        _, is_same = race_together(started, track="olivermath", steps=30, driving="random")
    assert not is_same


def test_a_failed_contender_reports_its_traceback():
    with (
        Contender(Spec("bare")) as contender,
        pytest.raises(RuntimeError, match=r"failed at 'race'(.|\n)*Traceback"),
    ):
        contender.ask("race")


@pytest.mark.parametrize("kind", ["stkzoo", "reference"])
def test_no_process_outlives_a_contender(kind):
    spec = Spec(kind, "multi", num_kart=1, num_agents=1, subprocess=True)
    with Contender(spec) as contender:
        contender.ask("load")
        contender.ask("make")
        contender.ask("reset", track="olivermath", seed=1)
        living = processes_below(contender.pid)
    assert len(living) > 1
    assert wait_until_gone(living) == []


def test_no_process_outlives_a_killed_driver():
    code = (
        "import os, signal\n"
        "from benchmarks.bench_driver import Contender, Spec\n"
        "c = Contender(Spec('reference', 'multi', num_kart=1, num_agents=1, subprocess=True))\n"
        "c.ask('load'), c.ask('make'), c.ask('reset', track='olivermath', seed=1)\n"
        "print(c.pid, flush=True)\n"
        "input()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as driver:
        contender = int(driver.stdout.readline())
        living = processes_below(contender)
        driver.kill()
    assert len(living) > 1
    assert wait_until_gone(living) == []


def test_memory_is_reported_for_program_fork_server_and_race():
    spec = Spec("stkzoo", num_kart=1, num_agents=1, subprocess=True)
    with Contender(spec) as contender:
        contender.ask("load")
        contender.ask("make")
        contender.ask("reset", track="olivermath", seed=1)
        found = processes(contender.pid)
    assert list(found) == ["program", "fork server or game", "race"]
    for sizes in found.values():
        assert 0 < sizes["own"] <= sizes["share"] <= sizes["resident"]


CONTROLS = [[1.0, 0.0, 0, 0, 0, 0, 0], [0.0, 1.0, 1, 0, 1, 0, 1], [0.5, -1.0, 0, 1, 0, 1, 0]]


def decoded(view, action):
    env = VIEWS_OF_STKZOO[view](kart_env())
    while env is not env.unwrapped:
        action = env.action(action) if hasattr(env, "action") else action
        env = env.env
    return action


@pytest.mark.parametrize("view", [v for v in VIEWS if v not in ("ground", *PHYSICAL_VIEWS)])
@pytest.mark.parametrize("control", CONTROLS)
def test_a_view_decodes_the_controls_that_it_can_express(view, control):
    style = driving_style(view)
    expressed = controls_of(style, to_action("full", np.array(control)))
    taken = decoded(view, to_action(view, np.array(expressed)))
    for key, value in to_action("full", np.array(expressed)).items():
        np.testing.assert_array_equal(np.ravel(taken.get(key, 0)), np.ravel(value))


@pytest.mark.parametrize("view", VIEWS)
def test_every_view_accepts_the_actions_of_the_benchmarks(view):
    space = race_v0.parallel_env(num_kart=1, view=view).action_space("kart_0")
    for row in RandomControls(8, view).next():
        assert space.contains(to_action(view, row))


@pytest.mark.parametrize("control", CONTROLS)
def test_a_control_on_the_grid_does_not_change(control):
    assert controls_of("grid", to_action("full", np.array(control))) == control


def test_random_controls_repeat_with_their_seed():
    one, same, other = (RandomControls(3, "full", seed) for seed in (1, 1, 2))
    rows = [[stream.next().tolist() for _ in range(9)] for stream in (one, same, other)]
    assert rows[0] == rows[1]
    assert rows[0] != rows[2]


def test_recorded_controls_repeat_after_their_end():
    controls = RecordedControls([[CONTROLS[0]], [CONTROLS[1]]])
    taken = [controls.next().tolist() for _ in range(3)]
    assert taken == [[CONTROLS[0]], [CONTROLS[1]], [CONTROLS[0]]]


@pytest.mark.parametrize("style", ["grid", "physical"])
def test_recorded_karts_drive(style):
    rows = np.array(record_controls("olivermath", 2, 2, 1, 30, style))
    assert rows.shape == (30, 2, 7)
    assert np.median(rows[..., 0]) > 0


def test_quantiles_match_numpy():
    values = np.random.default_rng(0).random(50)
    found = quantiles(values)
    assert list(found.values()) == pytest.approx(np.quantile(values, [0.5, 0.1, 0.9]).tolist())


def test_quantiles_of_an_empty_list_are_refused():
    with pytest.raises(ValueError, match="no values"):
        quantiles([])


def test_ratios_are_computed_step_by_step():
    times = {"total": [3e-6, 8e-6, 5e-6], "engine": [1e-6, 2e-6, 5e-6]}
    found = figures(times)
    assert found["ratio"]["median"] == pytest.approx(3.0)
    assert found["overhead"]["median"] == pytest.approx(2.0)


def test_a_contender_without_engine_times_has_no_ratio():
    times = {"total": [1e-6, 2e-6], "engine": [None, None]}
    assert set(figures(times)) == {"step"}


def test_a_table_is_written_as_markdown():
    table = Table("title", ("", "x"), [("row", "1")], "note")
    assert table.to_markdown() == "**title**\n\n|  | x |\n| :-- | --: |\n| row | 1 |\n\nnote\n"


def test_the_reference_is_left_out_of_views_in_which_it_fails():
    options = argparse.Namespace(karts=[1], single_karts=[1], group=GROUPS, view=VIEWS, cores=1)
    rivals = {
        (match.group, match.view)
        for match in matches(options)
        if any(spec.kind == "reference" for spec in match.specs.values())
    }
    assert rivals == {("multi", "full"), ("single", "full")}


@pytest.mark.parametrize("name", NAMES)
def test_each_part_of_a_learned_drivers_decision_is_timed(name):
    parts = cost(name, karts=2, track="lighthouse", steps=3)
    assert tuple(parts) == PARTS
    assert all(time > 0 for time in parts.values())


def test_each_kind_of_opponent_is_timed():
    times = opponents.cost(races=1, steps=20, track="lighthouse")
    assert [*times] == ["bots", "ai:3", "one by one", "together"]
    assert all(time > 0 for time in times.values())
