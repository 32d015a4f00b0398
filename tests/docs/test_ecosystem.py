"""The examples of docs/how-to/works-with.md run with each installed library."""

import functools
import importlib.util
import os
import subprocess
import sys

import numpy as np
import pytest

import stkzoo
from tests.support.paths import ROOT
from tests.support.views import marked

EXAMPLES = ROOT / "examples" / "ecosystem"
#: Examples that need only the tests' extras. ``python -m benchmarks.ecosystem`` runs all.
HERE = ("gymnasium_vector", "supersuit_sb3", "sb3_ppo", "cleanrl_ppo")


@pytest.mark.slow
@pytest.mark.parametrize("script", marked(HERE, ["sb3_ppo"]))
def test_an_example_runs(script):
    done = subprocess.run(
        [sys.executable, EXAMPLES / f"{script}.py"],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert "steps" in done.stdout or "races over" in done.stdout


def test_cleanrl_evaluates_the_last_observation_of_a_truncated_episode(monkeypatch):
    path = EXAMPLES / "cleanrl_ppo.py"
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


def test_the_page_has_a_row_for_every_example():
    page = (ROOT / "docs" / "how-to" / "works-with.md").read_text()
    for script in EXAMPLES.glob("*.py"):
        assert f"../examples/ecosystem/{script.name}) |" in page
