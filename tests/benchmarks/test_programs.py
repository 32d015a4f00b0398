"""The benchmark programs run, save their measurements, and show their help."""

import json
import os
import subprocess
import sys

import pytest

from tests.support.paths import ROOT

pytestmark = pytest.mark.slow

PROGRAMS = ("bench_all", "ecosystem", "parity", "suite_baselines", "suite_reference")


def run(program, *words):
    """Runs a program; returns its output."""
    command = [sys.executable, "-m", f"benchmarks.{program}", *map(str, words)]
    # The reference compiles its rotations in each process; short runs are faster without.
    variables = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        command, cwd=ROOT, env=variables, capture_output=True, text=True, timeout=500, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_has_help(program):
    assert f"python -m benchmarks.{program}" in run(program, "--help")


def test_a_short_run_of_all_benchmarks_saves_its_measurements(tmp_path):
    run("bench_all", "--quick", "--output", tmp_path)
    reports = {file.stem: json.loads(file.read_text()) for file in tmp_path.glob("*.json")}
    assert {"steps", "transport", "resets", "memory", "vector", "states", "learners"} < {*reports}
    for report in reports.values():
        assert report["host"]["packages"]["PySuperTuxKart2"]
        assert report["results"]
        assert report["tables"][0]["rows"]
        assert "/" not in report["command"] + json.dumps(report["settings"])
