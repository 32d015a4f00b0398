"""The examples of docs/works-with.md: those of the libraries that development brings are run."""

import json
import os
import subprocess
import sys

import pytest

from benchmarks import ecosystem

#: Needs nothing but the extras that the tests have. `python -m benchmarks.ecosystem` runs all.
HERE = ("gymnasium_vector", "supersuit_sb3", "sb3_ppo", "cleanrl_ppo")


@pytest.mark.slow
@pytest.mark.parametrize("script", HERE)
def test_an_example_runs(script):
    done = subprocess.run(
        [sys.executable, ecosystem.EXAMPLES / f"{script}.py"],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert "steps" in done.stdout or "races over" in done.stdout


def test_every_example_has_its_line():
    scripts = {path.stem for path in ecosystem.EXAMPLES.glob("*.py")}
    assert scripts == {example.script for example in ecosystem.LIBRARIES}


def test_every_library_has_passed_with_the_versions_that_are_pinned():
    outcomes = {
        outcome["library"]: outcome for outcome in json.loads(ecosystem.RESULTS.read_text())
    }
    pins = [pin for packages in ecosystem.SETS.values() for pin in packages]
    for example in ecosystem.LIBRARIES:
        outcome = outcomes[example.library]
        assert outcome["passed"], example.library
        mine = [pin for pin in pins if pin.partition("=")[0].partition("[")[0] == example.package]
        for pin in mine:
            assert outcome["version"].partition("+")[0] == pin.partition("==")[2]


def test_the_page_has_the_table():
    page = ecosystem.PAGE.read_text()
    _, table, _ = page.split(ecosystem.MARK)
    for example in ecosystem.LIBRARIES:
        assert f"| {example.library} |" in table
        assert f"../examples/ecosystem/{example.script}.py" in table
    assert "failed" not in table
