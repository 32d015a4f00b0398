"""The benchmark programs run, save their measurements, and continue interrupted runs."""

import hashlib
import json
import os
import subprocess
import sys
import zipfile

import pytest

from stkzoo.agents.planning.motion import LAYERS
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.suite import SuiteReport
from tests.support.paths import ROOT
from tests.support.suite_runs import constant, write_run

pytestmark = pytest.mark.slow

SUITE = "suite_baselines", "suite_pilot", "suite_reference", "suite_teams"
PROGRAMS = ("steps", "learners", "parity", "ecosystem", "learn_motion", *SUITE)


def run(program, *words, expected=0):
    """Runs a program; returns its output."""
    command = [sys.executable, "-m", f"benchmarks.{program}", *map(str, words)]
    # The reference compiles its rotations in each process; short runs are faster without.
    variables = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        command, cwd=ROOT, env=variables, capture_output=True, text=True, timeout=500, check=False
    )
    assert done.returncode == expected, done.stderr[-3000:]
    return done.stdout


def report_of(file):
    """Returns a saved report after checking its parts."""
    report = json.loads(file.read_text())
    assert report["host"]["packages"]["PySuperTuxKart2"]
    assert report["tables"][0]["rows"]
    assert str(ROOT.parent) not in file.read_text()
    return report


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_has_help(program):
    assert f"python -m benchmarks.{program}" in run(program, "--help")


@pytest.mark.matrix
def test_contenders_drive_the_same_race_and_an_interrupted_run_continues(tmp_path):
    words = ["--section", "steps", "--quick", "--output", tmp_path]
    run("steps", *words)
    report = report_of(tmp_path / "steps.json")
    parallel, multi, single = report["results"]
    ours = {"engine", "stkzoo, in process", "stkzoo, worker"}
    theirs = {"reference, in process", "reference, subprocess"}
    assert set(parallel["contenders"]) == ours | {"stkzoo, events"}
    assert set(multi["contenders"]) == set(single["contenders"]) == ours | theirs
    for result in report["results"]:
        assert result["same_race"]
        for times in result["contenders"].values():
            assert 0 < times["engine"]["median"] < times["step"]["p90"]
    report["results"] = [{**parallel, "kept": True}, {**multi, "kept": True}]
    (tmp_path / "steps.json").write_text(json.dumps(report))
    run("steps", *words)
    again = report_of(tmp_path / "steps.json")
    assert [result.get("kept") for result in again["results"]] == [True, True, None]
    assert again["command"] == report["command"]


@pytest.mark.parametrize(
    "section",
    [
        "states",
        *(
            pytest.param(name, marks=pytest.mark.matrix)
            for name in ("transport", "scaling", "resets", "memory", "vector")
        ),
    ],
)
def test_a_section_saves_its_measurements(section, tmp_path):
    run("steps", "--section", section, "--quick", "--output", tmp_path)
    assert report_of(tmp_path / f"{section}.json")["results"]


@pytest.mark.matrix
def test_the_rates_of_learners_are_compared_with_the_engines(tmp_path):
    run("learners", "--only", "engine", "ppo", "pytorch", "--quick", "--output", tmp_path)
    report = report_of(tmp_path / "learners.json")
    engine, ppo, page = report["results"]
    assert engine["rate"] > ppo["rate"] > 0
    assert ppo["engine"] + ppo["learning"] < 1
    assert 0 < page["engine"] < 1


@pytest.mark.matrix
def test_a_network_of_how_karts_move_is_learned(tmp_path):
    words = ["--rounds", 1, "--n-epochs", 3, "--hidden", 8, 6, "--output", tmp_path]
    assert "median" in run("learn_motion", *words)
    weights = load_weights(tmp_path / "motion.safetensors")
    shapes = [(8, 16), (8,), (6, 8), (6,), (3, 6), (3,)]
    assert [weights[name].shape for name in LAYERS] == shapes


def test_nothing_is_installed_without_consent(tmp_path):
    folder = tmp_path / "environments"
    words = ["--only", "torchrl", "--folder", folder]
    assert "installs up to 3 GB" in run("ecosystem", *words, expected=1)
    assert not folder.exists()


def test_reference_runs_that_are_not_trained_are_not_evaluated(tmp_path):
    words = ["--only", "versus-ippo-0", "--only-evaluate", "--folder", tmp_path]
    run("suite_reference", *words)
    assert not list(tmp_path.iterdir())
    run("suite_reference", "--only", "versus-ippo", expected=2)


def test_the_archive_of_reference_runs_has_digests_of_their_files(tmp_path):
    home = write_run(tmp_path / "runs", "solo-general", "ippo", 0, constant(1.0))
    (home / "agent").mkdir()
    (home / "agent" / "weights.safetensors").write_bytes(b"weights")
    (home / "checkpoint.pt").write_bytes(b"not packed")
    archives = [tmp_path / f"{number}.zip" for number in range(2)]
    for archive in archives:
        pack(tmp_path / "runs", archive)
    assert archives[0].read_bytes() == archives[1].read_bytes()
    digests = json.loads((tmp_path / "digests.json").read_text())
    assert digests["archives"] == dict.fromkeys(
        ("0.zip", "1.zip"), sha256(archives[1].read_bytes())
    )
    with zipfile.ZipFile(archives[1]) as packed:
        names = {name for name in packed.namelist() if not name.endswith(".stkz")}
        assert names == {*digests["files"]}
        assert len(packed.namelist()) - len(names) == 60 + 30
        for name, digest in digests["files"].items():
            assert sha256(packed.read(name)) == digest
    weights = "solo-general-ippo-0/agent/weights.safetensors"
    assert weights in names
    assert "solo-general-ippo-0/checkpoint.pt" not in names


def test_the_report_has_the_reference_runs_of_all_machines(tmp_path):
    for seed, ratio in enumerate((1.0, 1.5)):
        write_run(tmp_path / f"machine-{seed}", "solo-general", "ippo", seed, constant(ratio))
        pack(tmp_path / f"machine-{seed}", tmp_path / f"{seed}.zip")
    (task,) = SuiteReport.load(tmp_path / "report.json").tasks
    (ippo,) = task.algorithms
    assert (ippo.seeds, ippo.over_runs.value) == ((0, 1), pytest.approx(1.25, abs=0.001))
    assert (ippo.train_score is None, ippo.returns is None) == (False, False)


def pack(folder, archive):
    words = ["--folder", folder, "--output", archive.parent, "--archive", archive]
    run("suite_reference", *words)


def sha256(data):
    return hashlib.sha256(data).hexdigest()
