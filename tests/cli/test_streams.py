"""Commands with a full or closed stdout, and races with unwritable outputs."""

import json
import os
import subprocess
import sys
import textwrap

import pytest

from stkzoo.race import RaceResult
from tests.support.paths import AGENTS, ROOT

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


@pytest.mark.parametrize(
    ("words", "redirection", "cause"),
    [("", ">/dev/full", "No space left on device"), ("--json", ">&-", "Bad file descriptor")],
    ids=["full", "closed"],
)
def test_an_unwritable_stdout_is_one_error_and_the_file_is_kept(
    tmp_path, words, redirection, cause
):
    file = tmp_path / "race.json"
    done = stkzoo(f"{RACE} {words} --output {file}", redirection)
    assert done.returncode == 1
    assert done.stderr == f"stkzoo: stdout cannot be written: {cause}; send it to another file\n"
    assert RaceResult.from_json(file.read_text()).steps == 3


@pytest.mark.parametrize("command", ["karts", "race --help"])
def test_every_command_reports_a_full_stdout_in_one_line(command):
    done = stkzoo(command, ">/dev/full")
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) <= 1


def test_a_closed_stderr_has_no_effect():
    done = stkzoo(f"{RACE} --json", "2>&-")
    assert json.loads(done.stdout)["steps"] == 3
    assert done.returncode == 0


def test_the_file_is_written_if_all_streams_are_closed(tmp_path):
    file = tmp_path / "race.json"
    stkzoo(f"{RACE} --output {file}", "<&- >&- 2>&-")
    assert RaceResult.from_json(file.read_text()).steps == 3


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


@pytest.mark.parametrize("event", ["stepped", "ended"])
def test_a_failed_output_does_not_lose_the_result(tmp_path, event):
    done = run_with_failing_listener(tmp_path, event, "raise OSError(28, 'No space left')")
    assert done.returncode == 1
    assert done.stderr.splitlines() == ["stkzoo: OSError: [Errno 28] No space left"]
    assert RaceResult.from_json((tmp_path / "race.json").read_text()).steps == 3


def test_an_interrupt_while_outputs_are_written_keeps_the_result(tmp_path):
    done = run_with_failing_listener(tmp_path, "ended", "raise KeyboardInterrupt")
    assert done.returncode == 130
    assert RaceResult.from_json((tmp_path / "race.json").read_text()).steps == 3


IMPORTS = """
    import sys
    from stkzoo.cli import main
    from stkzoo.race.runner import _RaceRun

    before, step = [], _RaceRun._step

    def first_step(race):
        before.append(set(sys.modules))
        _RaceRun._step = step
        step(race)

    _RaceRun._step = first_step
    main(sys.argv[1:])
    print(*sorted(set(sys.modules) - before[0]), file=open("modules", "w"))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        "race {plain} random ai --output race.json --replay race.stkz --show-output",
        "race {plain} ai --json --web --web-port 0 --web-speed max --video race.mp4 "
        "--render-backend map --hide",
        "race {failing} ai --error-handling restart --web --web-port 0 --web-speed max",
        "race heuristic pretrained:ace ai --races 2",
    ],
    ids=["files", "web and video", "an agent that fails", "a series"],
)
def test_nothing_is_imported_after_the_start_of_a_race(tmp_path, words):
    """A module that is needed later may no longer be readable."""
    failing = tmp_path / "failing"
    failing.mkdir()
    (failing / "pystk_actor.py").write_text(
        "def get_actor(*_):\n    def act(*_):\n        raise OSError('no')\n    return act\n"
    )
    words = words.format(plain=AGENTS / "plain", failing=failing)
    program = [sys.executable, "-c", textwrap.dedent(IMPORTS), *words.split()]
    subprocess.run(
        [*program, "--track", "lighthouse", "--max-steps", "10"],
        timeout=120,
        check=True,
        cwd=tmp_path,
        capture_output=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert (tmp_path / "modules").read_text().split() == []
