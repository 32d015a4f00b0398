"""The examples of docs/how-to/works-with.md run with each installed library."""

import io
import os
import subprocess
import sys

import pytest

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
