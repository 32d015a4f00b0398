"""A game in the program itself, next to what the program does with the engine."""

import subprocess
import sys

import pytest

from tests.support.paths import ROOT

BEGINNING = """
import os, pystk2
from stkzoo import ApiOrderError, race_v0
from stkzoo.engine.assets import find_assets

os.environ["SUPERTUXKART_DATADIR"] = str(find_assets().root)
env = race_v0.parallel_env(num_kart=2, track="lighthouse", use_subprocess=False)

def init():
    pystk2.init(pystk2.GraphicsConfig.none())

def new_race():
    config = pystk2.RaceConfig(num_kart=1, track="lighthouse")
    config.num_cameras = 0
    return pystk2.Race(config)

def refused(call, *expected):
    try:
        call()
    except ApiOrderError as error:
        assert all(text in str(error) for text in expected), error
    else:
        raise AssertionError(f"{call} was not refused")
"""
PROGRAM_STARTED_IT = """
init()
refused(env.reset, "has called pystk2.init()", "leave use_subprocess at True")
if not (child := os.fork()):
    refused(env.reset, "has called pystk2.init()")
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
other = race_v0.parallel_env(num_kart=2, track="lighthouse")
race = new_race()
other.reset(seed=1)
other.step({agent: other.action_space(agent).sample() for agent in other.agents})
other.close()
"""
STKZOO_STARTED_IT = """
env.reset(seed=1)
refused(init, "crashes a program that calls it twice", "use_subprocess")
if not (child := os.fork()):
    env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    refused(init, "crashes a program that calls it twice")
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
env.close()
refused(init, "crashes a program that calls it twice")
race = new_race()
refused(env.reset, "has a pystk2.Race; delete it")
del race
env.reset(seed=1)
env.close()
pystk2.clean()
refused(env.reset, "has called pystk2.clean()")
"""


@pytest.mark.parametrize("program", [PROGRAM_STARTED_IT, STKZOO_STARTED_IT])
def test_two_uses_of_the_engine_in_one_process_are_refused(program):
    done = subprocess.run(
        [sys.executable, "-c", BEGINNING + program],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
