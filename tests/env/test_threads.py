"""Calls from several threads and from signal handlers, and forks of the program."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest

import stkzoo
from stkzoo import ApiOrderError, EngineError, race_v0
from stkzoo.engine import fork_client, wire
from tests.support.paths import ROOT
from tests.support.playing import fingerprint
from tests.support.processes import (
    children_of,
    fork_server_of_races,
    process_exists,
    run_program,
    wait_until,
)

OPTIONS = {"num_kart": 2, "track": "lighthouse", "view": "flattened_discrete"}


class Parallel:
    """The parallel environment, with the calls that all environments have."""

    def __init__(self):
        self.env = self.core = race_v0.parallel_env(**OPTIONS)
        self.turn = self.core.live_race.turn

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
        self.turn = self.core.live_race.turn

    def step(self):
        return self.env.step(0)

    def calls(self):
        yield from (self.env.reset, self.step, self.env.close, self.env.save_state)


class Vector(Single):
    """The Gymnasium vector environment."""

    def __init__(self):
        self.env = stkzoo.RaceVectorEnv(2, **OPTIONS)
        self.core, self.turn = self.env.races[1], self.env._turn

    def step(self):
        return self.env.step([0] * self.env.num_envs)

    def calls(self):
        yield from (self.env.reset, self.step, self.env.close, lambda: self.env.set_options({}))


FORMS = [Parallel, Single, Vector]


def is_taken(turn):
    """Returns whether another thread holds the turn."""
    with contextlib.suppress(ApiOrderError), turn:
        return False
    return True


@contextmanager
def stepping(form):
    """Holds another thread in the middle of a step by stopping its game."""
    pid, results = form.core.live_race.session.pid, []
    os.kill(pid, signal.SIGSTOP)
    thread = threading.Thread(target=lambda: results.append(form.step()))
    thread.start()
    try:
        assert wait_until(lambda: is_taken(form.turn))
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
            with pytest.raises(ApiOrderError, match="another thread's call runs"):
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
    os.kill(env.live_race.session.pid, signal.SIGSTOP)
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
        ("env.reset()", "env.step(actions)", "ApiOrderError"),
    ],
    ids=["close-and-exit", "reset"],
)
def test_a_signal_handler_can_end_the_step_that_it_interrupts(handler, then, error):
    program = run_program(SIGNALS.format(handler=handler, then=then))
    assert program.stdout.split("\n")[:2] == [error, "goes on"], program.stderr


@pytest.mark.parametrize("kind", ["parallel", "batch"])
def test_a_signal_handler_cannot_save_or_copy_the_race_in_the_middle_of_a_step(monkeypatch, kind):
    form = Parallel() if kind == "parallel" else Vector()
    race, receive, refused = form.core, wire.receive, []

    def interrupted(connection):
        if connection is race.live_race.session._process.connection:
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


def in_thread(work):
    results = []
    thread = threading.Thread(target=lambda: results.append(work()))
    thread.start()
    thread.join()
    return results.pop()


def trace(env):
    return fingerprint(
        [env.reset(seed=1), *(env.step(dict.fromkeys(env.agents, 0)) for _ in range(20))]
    )


@pytest.mark.slow
def test_an_environment_can_move_between_threads():
    fork_client._close_all()  # so that the fork server becomes a child of a thread that ends
    env = in_thread(lambda: race_v0.parallel_env(**OPTIONS))
    first = in_thread(lambda: trace(env))
    assert in_thread(lambda: trace(env)) == first
    assert trace(env) == first
    pid = env.live_race.session.pid
    in_thread(env.close)
    assert wait_until(lambda: not process_exists(pid))


@pytest.mark.slow
def test_races_in_threads_recover_when_they_are_killed():
    with race_v0.parallel_env(**OPTIONS) as env:
        expected = trace(env)
    fork_server, stop, lost = fork_server_of_races()._process.pid, threading.Event(), []

    def race():
        with race_v0.parallel_env(**OPTIONS) as env:
            while not stop.is_set():
                try:
                    if trace(env) != expected:
                        lost.append("another race")
                except EngineError:  # noqa: PERF203 - the loop retries after each crash
                    continue
                except Exception as error:
                    lost.append(repr(error))
                    raise

    threads = [threading.Thread(target=race) for _ in range(3)]
    for thread in threads:
        thread.start()
    chance, kills = random.Random(1), 0
    while kills < 20 and any(thread.is_alive() for thread in threads):
        time.sleep(0.05)
        with contextlib.suppress(ProcessLookupError, IndexError):
            os.kill(chance.choice(children_of(fork_server)), signal.SIGKILL)
            kills += 1
    stop.set()
    for thread in threads:
        thread.join(60)
    assert lost == []
    assert kills == 20
    assert fork_server_of_races()._process.pid == fork_server
    assert wait_until(lambda: not children_of(fork_server))


WORKERS = """
import multiprocessing, sys
from stkzoo import race_v0
from tests.env.test_threads import OPTIONS, trace

def work(answers):
    with race_v0.parallel_env(**OPTIONS) as env:
        answers.put(trace(env))

if __name__ == "__main__":
    context = multiprocessing.get_context(sys.argv[1])
    mine = race_v0.parallel_env(**OPTIONS)
    expected = trace(mine)
    mine.reset(seed=2)
    answers = context.Queue()
    workers = [context.Process(target=work, args=(answers,), daemon=True) for _ in range(2)]
    for worker in workers:
        worker.start()
    mine.step(dict.fromkeys(mine.agents, 0))
    print([answers.get(timeout=60) == expected for _ in workers], trace(mine) == expected)
    for worker in workers:
        worker.join()
"""


@pytest.mark.slow
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_worker_processes_run_the_same_race_and_leave_nothing(tmp_path, method):
    (tmp_path / "tmp").mkdir()
    file = tmp_path / "workers.py"
    file.write_text(WORKERS)
    variables = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path / "tmp")}
    command = [sys.executable, str(file), method]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=variables)
    assert done.stdout.strip() == "[True, True] True", done.stderr
    assert list((tmp_path / "tmp").iterdir()) == []
