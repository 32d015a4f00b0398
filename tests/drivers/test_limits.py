"""Agents from files race where shared servers and clusters limit processes."""

import sys

import pytest

from tests.support.limits import run_limited
from tests.support.paths import AGENTS

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the limits are those of Linux")

AGENT = str(AGENTS / "alpha")
LIMITS = {
    "RLIMIT_NOFILE": 256,
    "RLIMIT_FSIZE": 1 << 20,
    "RLIMIT_CPU": 60,
    "RLIMIT_DATA": 1 << 30,
    "RLIMIT_AS": 3 << 30,
    "RLIMIT_NPROC": 400,
    "RLIMIT_MSGQUEUE": 0,
    "RLIMIT_CORE": 0,
}
PROGRAM = f"""
from stkzoo.cli import main
from stkzoo.drivers import find_driver
from tests.support.remote_race import server_thread

race = "--track lighthouse --max-steps 5".split()
assert main(["check", {AGENT!r}, "--max-steps", "5", "--sandbox", {{sandbox!r}}]) == 0
with server_thread([find_driver({AGENT!r})]) as server:
    place = server.address.removeprefix("tcp://")
    assert main(["race-client", "ai", {AGENT!r}, "--server", place, *race]) == 0
"""


@pytest.mark.slow
@pytest.mark.parametrize("sandbox", ["auto", "off"])
def test_agents_race_under_hard_limits_below_those_of_agents(sandbox):
    done = run_limited(PROGRAM.format(sandbox=sandbox), LIMITS)
    assert done.returncode == 0, done.stderr
    assert "could not be loaded" not in done.stdout + done.stderr


RACE = ("race", AGENT, "ai", "--track", "lighthouse")
NO_FILES, FEW_FILES = {"RLIMIT_FSIZE": 0}, {"RLIMIT_NOFILE": 12}


@pytest.mark.parametrize(
    ("limits", "words", "expected"),
    [
        (NO_FILES, RACE, "set TMPDIR to a folder that exists, is writable and has room"),
        (NO_FILES, ["doctor"], "set TMPDIR to a folder that exists, is writable and has room"),
        (FEW_FILES, RACE, "alpha (kart_0) could not be loaded: [Errno 24] Too many open files"),
    ],
)
def test_a_limit_that_is_too_low_is_one_error(limits, words, expected):
    code = f"import sys; from stkzoo.cli import main; sys.exit(main({[*words]}))"
    done = run_limited(code, limits, COLUMNS="500")
    assert done.returncode in (1, 3)
    assert expected in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
