"""The examples of docs/how-to/works-with.md run with each installed library."""

import functools
import importlib.util
import io
import os
import subprocess
import sys

import numpy as np
import pytest

import stkzoo
from benchmarks import ecosystem

#: Examples that need only the tests' extras. ``python -m benchmarks.ecosystem`` runs all.
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


def test_cleanrl_evaluates_the_last_observation_of_a_truncated_episode(monkeypatch):
    path = ecosystem.EXAMPLES / "cleanrl_ppo.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    evaluated, last = [], []

    class RecordingAgent(script.Agent):
        def forward(self, seen, *others):
            evaluated.extend(row.tobytes() for row in seen.numpy())
            return super().forward(seen, *others)

    class ShortRaces(stkzoo.RaceVectorEnv):
        def step(self, actions):
            *found, infos = super().step(actions)
            last.extend(infos["final_obs"][slot] for slot in np.flatnonzero(found[3]))
            return *found, infos

    monkeypatch.setattr(script, "Agent", RecordingAgent)
    monkeypatch.setattr(stkzoo, "RaceVectorEnv", functools.partial(ShortRaces, max_cycles=6))
    options = ["--races=1", "--karts=2", "--horizon=8", "--total-steps=16"]
    monkeypatch.setattr(sys, "argv", [path.name, *options])
    script.main()
    assert len(last) == 2
    assert {each["observation"].tobytes() for each in last} <= {*evaluated}


def test_nothing_is_installed_without_consent(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "environments"
    monkeypatch.setattr(sys, "argv", ["ecosystem", "--only", "torchrl", "--folder", str(folder)])
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    assert ecosystem.main() == 1
    assert "This installs up to 3 GB" in capsys.readouterr().out
    assert not folder.exists()


def test_every_example_is_listed():
    scripts = {path.stem for path in ecosystem.EXAMPLES.glob("*.py")}
    assert scripts == {example.script for example in ecosystem.LIBRARIES}


def test_the_page_has_a_row_for_every_library():
    _, table, _ = ecosystem.PAGE.read_text().split(ecosystem.MARK)
    for example in ecosystem.LIBRARIES:
        assert f"| {example.library} |" in table
        assert f"../examples/ecosystem/{example.script}.py" in table
