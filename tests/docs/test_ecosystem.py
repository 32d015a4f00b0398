"""The examples of docs/how-to/works-with.md run with each installed library."""

import os
import subprocess
import sys

import pytest

from tests.support.paths import ROOT
from tests.support.views import marked

EXAMPLES = ROOT / "examples" / "ecosystem"
#: Examples that need only the tests' extras. ``python -m benchmarks.ecosystem`` runs all.
HERE = ("gymnasium_vector", "supersuit_sb3", "sb3_ppo", "cleanrl_ppo")
SHORTER = {"cleanrl_ppo": ["--total-steps", "1200"]}


@pytest.mark.slow
@pytest.mark.parametrize("script", marked(HERE, ["sb3_ppo"]))
def test_an_example_runs(script):
    done = subprocess.run(
        [sys.executable, EXAMPLES / f"{script}.py", *SHORTER.get(script, [])],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert "steps" in done.stdout or "races over" in done.stdout


def test_the_page_has_a_row_for_every_example():
    page = (ROOT / "docs" / "how-to" / "works-with.md").read_text()
    for script in EXAMPLES.glob("*.py"):
        assert f"../examples/ecosystem/{script.name}) |" in page
