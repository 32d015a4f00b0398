"""Actor processes: shared memory, errors and shutdown."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from stkzoo.agents.training.common import actors
from stkzoo.agents.training.common.actors import ActorPool, SharedArray
from stkzoo.errors import ConfigError, EngineCrashed, StkzooError


class Counter:
    """An actor that adds to a shared number."""

    def __init__(self, memory, start):
        if start < 0:
            raise ConfigError(f"start is {start}, expected 0 or more")
        self._sum = memory.array()
        self._sum[:] = start

    def add(self, number):
        self._sum += number
        return int(self._sum.flat[0])

    def crash(self):
        raise EngineCrashed("the game ended by SIGSEGV", "its last line")

    def divide(self):
        return 1 // 0

    def read(self):
        return Path("/nowhere/file").read_text()

    def sleep(self, seconds):
        time.sleep(seconds)

    def close(self):
        pass


@pytest.fixture
def pool():
    found = ActorPool(Counter, [(SharedArray((1,), np.int64), n) for n in (0, 5)])
    yield found
    found.close()


@pytest.mark.slow
def test_results_and_memory_are_shared():
    memories = [SharedArray((2, 3), np.float32) for _ in range(2)]
    pool = ActorPool(Counter, [(memory, 0) for memory in memories])
    try:
        assert pool.call("add", [(1,), (2,)]) == [1, 2]
        pool.send("add", [(1,), (2,)])
        assert pool.is_busy
        assert pool.receive() == [2, 4]
        assert not pool.is_busy
        assert (memories[1].array() == 4).all()
    finally:
        pool.close()


def test_errors_of_actors_are_raised_in_the_learner():
    pool = ActorPool(Counter, [(SharedArray((1,), np.int64), 0)])
    try:
        for method, kind, message in (
            ("crash", EngineCrashed, "SIGSEGV"),
            ("divide", StkzooError, "ZeroDivisionError"),
            ("read", StkzooError, "/nowhere/file"),
        ):
            with pytest.raises(kind, match=message):
                pool.call(method, [()])
    finally:
        pool.close()


def test_errors_at_the_start_of_an_actor_are_raised_in_the_learner():
    pool = ActorPool(Counter, [(SharedArray((1,), np.int64), -1)])
    try:
        with pytest.raises(ConfigError, match="start is -1"):
            pool.call("add", [(1,)])
    finally:
        pool.close()


@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
def test_a_killed_actor_is_reported(monkeypatch, pool):
    monkeypatch.setattr(actors, "_END_TIMEOUT", 0.1)  # the other actor still sleeps when pool ends
    pool.send("sleep", [(600,)] * 2)
    os.kill(pool.pids[0], signal.SIGKILL)
    with pytest.raises(StkzooError, match="code -9; the same command continues"):
        pool.receive()
