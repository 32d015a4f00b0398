"""The check whether sandboxes work on this machine."""

import os

import pytest

from stkzoo.drivers.sandbox import bubblewrap_problem
from tests.support.processes import run_program

IGNORING = """
    import signal
    from stkzoo.drivers import sandbox
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    sandbox._TRIAL_TIMEOUT = 60
    print(sandbox.bubblewrap_problem())
"""


@pytest.mark.skipif(bool(bubblewrap_problem()), reason=bubblewrap_problem())
def test_bubblewrap_works_in_a_program_that_ignores_its_children():
    assert run_program(IGNORING).stdout == "\n"


def test_a_bubblewrap_that_fails_is_noticed_in_a_program_that_ignores_its_children(tmp_path):
    (tmp_path / "bwrap").write_text("#!/bin/sh\necho no namespaces >&2\nexit 1\n")
    (tmp_path / "bwrap").chmod(0o755)
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    assert "no namespaces" in run_program(IGNORING, env={**os.environ, "PATH": path}).stdout
