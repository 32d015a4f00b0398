"""Commands with a full stdout, and races with unwritable outputs."""

import os
import subprocess
import sys
import textwrap

import pytest

from stkzoo.race import RaceResult
from tests.support.paths import ROOT

RACE = "race random ai --track lighthouse --max-steps 3 --seed 1"


def stkzoo(words, redirection="", **variables):
    """Runs a command in a shell."""
    command = f'exec "$0" -m stkzoo {words} {redirection}'
    return subprocess.run(
        ["sh", "-c", command, sys.executable],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), **variables},
    )


@pytest.mark.slow
def test_a_full_stdout_is_one_error_and_the_file_is_kept(tmp_path):
    file = tmp_path / "race.json"
    done = stkzoo(f"{RACE} --output {file}", ">/dev/full")
    assert done.returncode == 1
    assert done.stderr == (
        "stkzoo: stdout cannot be written: No space left on device; send it to another file\n"
    )
    assert RaceResult.from_json(file.read_text()).steps == 3


@pytest.mark.slow
def test_a_name_that_the_terminal_cannot_show_is_escaped():
    name = "random@:\N{CHEQUERED FLAG}:fire:"
    done = stkzoo(f"race '{name}' --track lighthouse --max-steps 2", PYTHONIOENCODING="ascii")
    assert "\\U0001f3c1:fire:" in done.stdout
    assert done.returncode == 0


def run_with_failing_listener(tmp_path, event, code):
    """Runs a race whose replay writer fails on an event."""
    program = f"""
        import sys
        from stkzoo.cli import main
        from stkzoo.race.replay import ReplayWriter
        def fail(*_):
            {code}
        ReplayWriter.{event} = fail
        sys.exit(main({RACE.split()!r} + ["--replay", "race.stkz", "--output", "race.json"]))
    """
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


@pytest.mark.slow
@pytest.mark.parametrize("event", ["stepped", "ended"])
def test_a_failed_output_does_not_lose_the_result(tmp_path, event):
    done = run_with_failing_listener(tmp_path, event, "raise OSError(28, 'No space left')")
    assert done.returncode == 1
    assert done.stderr.splitlines() == ["stkzoo: OSError: [Errno 28] No space left"]
    assert RaceResult.from_json((tmp_path / "race.json").read_text()).steps == 3


@pytest.mark.slow
def test_an_interrupt_while_outputs_are_written_keeps_the_result(tmp_path):
    done = run_with_failing_listener(tmp_path, "ended", "raise KeyboardInterrupt")
    assert done.returncode == 130
    assert RaceResult.from_json((tmp_path / "race.json").read_text()).steps == 3
