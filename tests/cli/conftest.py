"""Commands in processes of their own."""

import textwrap

import pytest

from tests.support.programs import ProgramRunner

#: What a command that runs a race imports.
IMPORTS = """
import os, signal, sys, threading
from stkzoo import cli
from stkzoo.cli import race
from stkzoo.race import runner
"""


@pytest.fixture(scope="package")
def programs():
    with ProgramRunner(IMPORTS) as runner:
        yield runner


@pytest.fixture
def run_command(programs):
    def run(words, folder=".", before=""):
        """Runs a command in a folder, after a piece of code; returns the finished process."""
        code = f"{textwrap.dedent(before)}\nsys.exit(cli.main({words!r}))"
        return programs.run(code, folder)

    return run
