"""Commands with a full stdout, and races with unwritable outputs."""

import pytest

from stkzoo.race import RaceResult

RACE = ["race", "random", "ai", "--track=lighthouse", "--max-steps=3", "--output=race.json"]


def saved_steps(folder):
    return RaceResult.from_json((folder / "race.json").read_text()).steps


@pytest.mark.slow
def test_a_full_stdout_is_one_error_and_the_file_is_kept(tmp_path, run_command):
    done = run_command(RACE, tmp_path, "sys.stdout = open('/dev/full', 'w')")
    assert done.returncode == 1
    assert done.stderr == (
        "stkzoo: stdout cannot be written: No space left on device; send it to another file\n"
    )
    assert saved_steps(tmp_path) == 3


FAILING = """
    from stkzoo.race.replay import ReplayWriter
    def fail(*_):
        raise {error}
    ReplayWriter.{event} = fail
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("event", "error", "code", "text"),
    [
        ("stepped", "OSError(28, 'No space left')", 1, "stkzoo: OSError: [Errno 28] No space left"),
        ("ended", "OSError(28, 'No space left')", 1, "stkzoo: OSError: [Errno 28] No space left"),
        ("ended", "KeyboardInterrupt", 130, "stkzoo: interrupted; complete races: 1"),
    ],
)
def test_a_failed_output_does_not_lose_the_result(tmp_path, run_command, event, error, code, text):
    failing = FAILING.format(event=event, error=error)
    done = run_command([*RACE, "--replay", "race.stkz"], tmp_path, failing)
    assert (done.returncode, done.stderr) == (code, f"{text}\n")
    assert saved_steps(tmp_path) == 3
