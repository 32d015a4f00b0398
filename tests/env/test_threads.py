"""Calls during another thread's call, and calls from signal handlers."""

import contextlib
import os
import signal
import threading
from contextlib import contextmanager

import pytest

import stkzoo
from stkzoo import ApiOrderError, race_v0
from stkzoo.engine import wire
from tests.support.processes import run_program, wait_until

OPTIONS = {"num_kart": 2, "track": "lighthouse", "view": "flattened_discrete"}


class Parallel:
    """The parallel environment, with the calls that all environments have."""

    def __init__(self):
        self.env = self.core = race_v0.parallel_env(**OPTIONS)
        self.turn = self.core._turn

    def step(self):
        return self.env.step(dict.fromkeys(self.env.agents, 0))

    def calls(self):
        env = self.env
        yield from (env.reset, self.step, env.close, env.save_state, env.clone)
        yield lambda: env.step_async(dict.fromkeys(env.agents, 0))


class Single(Parallel):
    """A Gymnasium id."""

    def __init__(self):
        self.env = stkzoo.STKRaceEnv(**OPTIONS)
        self.core = self.env.core
        self.turn = self.core._turn

    def step(self):
        return self.env.step(0)

    def calls(self):
        yield from (self.env.reset, self.step, self.env.close, self.env.save_state)


class Multi(Single):
    """The multi-agent Gymnasium environment."""

    def __init__(self):
        self.env = stkzoo.STKRaceMultiEnv(**{**OPTIONS, "view": "full"})
        self.core = self.env.core
        self.turn = self.core._turn

    def step(self):
        return self.env.step(self.env.action_space.sample())


class Vector(Single):
    """The Gymnasium vector environment."""

    def __init__(self):
        self.env = stkzoo.RaceVectorEnv(2, **OPTIONS)
        self.core, self.turn = self.env.races[1], self.env._turn

    def step(self):
        return self.env.step([0] * self.env.num_envs)

    def calls(self):
        yield from (self.env.reset, self.step, self.env.close, lambda: self.env.set_options({}))


class StableBaselines(Vector):
    """The vector environment for Stable-Baselines3."""

    def __init__(self):
        self.env = pytest.importorskip("stkzoo.sb3").RaceVecEnv(2, **OPTIONS)
        self.core, self.turn = self.env.races.races[1], self.env.races._turn

    def calls(self):
        yield from (self.env.reset, self.step, self.env.close)


FORMS = [Parallel, Single, Multi, Vector, StableBaselines]


def is_stepping(turn):
    """Returns whether another thread holds the turn for a step."""
    if turn.lock.acquire(blocking=False):
        turn.lock.release()
        return False
    return turn.call in ("step", "step_wait")


@contextmanager
def stepping(form):
    """Holds another thread in the middle of a step by stopping its game."""
    pid, results = form.core._session.pid, []
    os.kill(pid, signal.SIGSTOP)
    thread = threading.Thread(target=lambda: results.append(form.step()))
    thread.start()
    try:
        assert wait_until(lambda: is_stepping(form.turn))
        yield results
    finally:
        os.kill(pid, signal.SIGCONT)
        thread.join()


@pytest.fixture
def form(request):
    form = request.param()
    form.env.reset()
    yield form
    form.env.close()


@pytest.mark.parametrize("form", FORMS, indirect=True, ids=lambda form: form.__name__)
def test_a_call_during_another_threads_step_is_refused_immediately(form):
    with stepping(form) as results:
        for call in form.calls():
            with pytest.raises(ApiOrderError, match=r"\(\) was called while .*step.*\(\) runs"):
                call()
    assert len(results) == 1
    form.env.reset()
    form.step()


SIGNALS = """
    import os, signal, sys, threading
    from stkzoo import ApiOrderError, race_v0
    options = dict(num_kart=2, track="lighthouse", view="flattened_discrete")
    env, other = (race_v0.parallel_env(**options) for _ in range(2))
    env.reset(seed=1)
    other.reset(seed=1)
    actions = dict.fromkeys(env.agents, 0)

    def handle(*_):
        {handler}

    signal.signal(signal.SIGALRM, handle)
    os.kill(env._session.pid, signal.SIGSTOP)
    signal.setitimer(signal.ITIMER_REAL, 0.3)
    try:
        env.step(actions)
    except (ApiOrderError, SystemExit) as error:
        print(type(error).__name__)
    {then}
    other.step(actions)
    env.reset()
    env.step(actions)
    print("goes on")
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("handler", "then", "error"),
    [
        ("env.close(); sys.exit()", "pass", "SystemExit"),
        ("env.close()", "pass", "ApiOrderError"),
        ("env.reset()", "env.step(actions)", "ApiOrderError"),
    ],
    ids=["close-and-exit", "close", "reset"],
)
def test_a_signal_handler_can_end_the_step_that_it_interrupts(handler, then, error):
    program = run_program(SIGNALS.format(handler=handler, then=then))
    assert program.stdout.split("\n")[:2] == [error, "goes on"], program.stderr


@pytest.mark.parametrize("kind", ["parallel", "batch"])
def test_a_signal_handler_cannot_save_or_copy_the_race_in_the_middle_of_a_step(monkeypatch, kind):
    form = Parallel() if kind == "parallel" else Vector()
    race, receive, refused = form.core, wire.receive, []

    def interrupted(connection):
        if connection is race._session._process.connection:
            monkeypatch.undo()
            for call in (race.save_state, race.clone, race.scenario):
                with pytest.raises(ApiOrderError):
                    call()
                refused.append(call)
        return receive(connection)

    with contextlib.closing(form.env):
        form.env.reset(seed=1)
        monkeypatch.setattr(wire, "receive", interrupted)
        form.step()
        assert len(refused) == 3
        form.step()
        assert len(race.scenario().controls) == 2
        with race.save_state() as state:
            assert state.race == race.race


@pytest.mark.slow
def test_a_process_forked_during_another_threads_step_can_reset():
    program = run_program("""
        import os, signal, threading, time
        from stkzoo import race_v0
        env = race_v0.parallel_env(num_kart=2, track="lighthouse", view="flattened_discrete")
        env.reset(seed=1)
        actions, game = {agent: 0 for agent in env.agents}, env._session.pid
        os.kill(game, signal.SIGSTOP)
        thread = threading.Thread(target=env.step, args=(actions,))
        thread.start()
        while env._turn.call != "step":
            time.sleep(0.01)
        time.sleep(0.2)
        child = os.fork()
        if child == 0:
            env.reset(seed=1)
            env.step(actions)
            os._exit(7)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
        os.kill(game, signal.SIGCONT)
        thread.join()
        env.step(actions)
        print("goes on")
    """)
    assert program.stdout.split("\n")[:2] == ["7", "goes on"], program.stderr
