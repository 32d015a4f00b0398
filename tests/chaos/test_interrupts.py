"""Ctrl-C at unfavorable moments."""

import os
import signal
import threading
import time
import zipfile

import numpy as np
import pytest

import stkzoo
from stkzoo import race_v0
from stkzoo.race import RaceListener, run_race
from tests.chaos.family import family
from tests.support.playing import fingerprint
from tests.support.processes import children_of, fork_server_of_races, wait_until

pytestmark = pytest.mark.slow

OPTIONS = {"num_kart": 2, "track": "olivermath", "view": "flattened_discrete"}


def make():
    return race_v0.parallel_env(**OPTIONS)


def trace(env):
    parts = [env.reset(seed=1)]
    parts.extend(env.step(dict.fromkeys(env.agents, 700)) for _ in range(20))
    return fingerprint(parts)


def interrupt_when(condition):
    """Sends Ctrl-C to this program from a thread once a condition holds."""

    def watch():
        wait_until(condition, 10)
        time.sleep(0.1)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=watch)
    thread.start()
    return thread


def test_an_interrupted_reset_does_not_mix_up_replies():
    """A late reply to an interrupted request must not be taken for the next request's reply."""
    with make() as env, make() as other:
        expected = trace(env)
        other.reset(seed=1)
        fork_server = fork_server_of_races()._process.pid
        for _ in range(3):
            os.kill(fork_server, signal.SIGSTOP)  # delays the replies
            thread = interrupt_when(lambda: True)
            with pytest.raises(KeyboardInterrupt):
                env.reset(seed=5)
            thread.join()
            os.kill(fork_server, signal.SIGCONT)
        assert trace(env) == expected
        assert fork_server_of_races()._process.pid == fork_server
        other.step(dict.fromkeys(other.agents, 0))
        # Races of interrupted requests end by themselves.
        assert wait_until(lambda: len(children_of(fork_server)) == 2)


def test_a_reset_recovers_from_an_interrupted_vector_step():
    envs = stkzoo.RaceVectorEnv(2, **OPTIONS)
    actions = np.full(4, 700)

    def seen():
        parts = [envs.reset(seed=1)]
        parts.extend(envs.step(actions) for _ in range(10))
        return fingerprint(parts)

    expected = seen()
    stopped = envs.races[1].live_race.session.pid
    os.kill(stopped, signal.SIGSTOP)
    thread = interrupt_when(lambda: True)
    with pytest.raises(KeyboardInterrupt):
        envs.step(actions)
    thread.join()
    with pytest.raises(stkzoo.ApiOrderError, match="reset"):
        envs.step(actions)
    assert seen() == expected
    assert wait_until(lambda: stopped not in children_of(fork_server_of_races()._process.pid))
    envs.close()


SLOW_TO_END = """
import atexit, time
env_name = "supertuxkart/flattened_discrete-v0"
atexit.register(time.sleep, 60)

def get_actor(module_dir, observation_space, action_space):
    return lambda state, observation: 0
"""


class InterruptedClosing(RaceListener):
    """Sends Ctrl-C while the runner waits for the end of an agent's process."""

    def ended(self, _):
        self.timer = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT))
        self.timer.start()

    def closed(self):
        self.timer.join()


def test_an_interrupted_closing_ends_the_agents_process_and_removes_its_files(
    tmp_path, monkeypatch
):
    with zipfile.ZipFile(tmp_path / "slow.zip", "w") as archive:
        archive.writestr("pystk_actor.py", SLOW_TO_END)
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    with pytest.raises(KeyboardInterrupt):
        run_race(
            [str(tmp_path / "slow.zip"), "ai"],
            listeners=[InterruptedClosing()],
            track="olivermath",
            max_steps=3,
        )
    assert not list(temporary.glob("*/agent-*"))
    assert wait_until(lambda: "agent" not in kinds(os.getpid()))


def kinds(program):
    return {member.kind for member in family(program)}
