"""Limits on open files and memory, clock changes, and programs with many processes or threads."""

import ast
import contextlib
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

import stkzoo
from stkzoo import EngineCrashed, EngineError, StkzooError, race_v0
from stkzoo.engine import fork_client
from tests.chaos.forms import digest
from tests.support.paths import AGENTS, ROOT
from tests.support.processes import (
    children_of,
    fork_server_of_races,
    process_exists,
    run_program,
    wait_until,
)

OPTIONS = {"num_kart": 2, "track": "olivermath", "view": "flattened_discrete"}


def make():
    return race_v0.parallel_env(**OPTIONS)


def step(env):
    return env.step(dict.fromkeys(env.agents, 700))


def trace(env):
    return digest([env.reset(seed=1), *(step(env) for _ in range(20))])


# ---------------------------------------------------------------------- open files


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_program_without_free_file_descriptors_says_so_and_recovers(method):
    code = """
        import resource
        from stkzoo import StkzooError, race_v0
        options = {"num_kart": 1, "track": "olivermath"}
        def race(env):
            env.reset(seed=1)
            env.step({"kart_0": env.action_space("kart_0").sample()})
        first = race_v0.parallel_env(**options)
        race(first)
        resource.setrlimit(resource.RLIMIT_NOFILE, (24, 24))
        envs, told = [], 0
        for _ in range(20):
            try:
                envs.append(race_v0.parallel_env(**options))
                race(envs[-1])
            except StkzooError as error:
                told += "open files" in str(error)
                if told == 3:
                    break
        first.step({"kart_0": first.action_space("kart_0").sample()})
        for env in envs:
            env.close()
        race(race_v0.parallel_env(**options))
        print(told, len(envs) > 3)
    """
    done = run_program(code, env={**os.environ, "STKZOO_START_METHOD": method})
    assert done.stdout.split() == ["3", "True"], done.stderr


def test_a_fork_server_without_free_file_descriptors_says_so_and_its_races_continue():
    with make() as env, make() as other:
        expected = trace(env)
        other.reset(seed=1)
        fork_server = fork_server_of_races()._process.pid
        used = len(os.listdir(f"/proc/{fork_server}/fd"))
        _, hard = resource.prlimit(fork_server, resource.RLIMIT_NOFILE)
        resource.prlimit(fork_server, resource.RLIMIT_NOFILE, (used, hard))
        with pytest.raises(EngineError, match="are too many files open"):
            env.reset(seed=1)
        step(other)
        resource.prlimit(fork_server, resource.RLIMIT_NOFILE, (hard, hard))
        assert fork_server_of_races()._process.pid == fork_server
        assert trace(env) == expected


# ---------------------------------------------------------------------- memory


def memory_of(pid):
    pages = Path(f"/proc/{pid}/statm").read_text().split()[0]
    return int(pages) * resource.getpagesize()


def test_a_game_without_memory_fails_only_its_own_race():
    with make() as env, make() as other:
        expected = trace(env)
        other.reset(seed=1)
        env.reset(seed=1)
        limit = memory_of(env._session.pid) // 2
        resource.prlimit(env._session.pid, resource.RLIMIT_AS, (limit, limit))
        try:
            for _ in range(300):
                step(env)
        except StkzooError as error:
            assert isinstance(error, EngineCrashed)  # noqa: PT017 - it may also continue
        step(other)
        assert trace(env) == expected


def test_a_fork_server_without_memory_raises_an_error_and_recovers():
    with make() as env:
        expected = trace(env)
        fork_server = fork_server_of_races()._process.pid
        _, hard = resource.prlimit(fork_server, resource.RLIMIT_AS)
        limit = memory_of(fork_server) + (4 << 20)
        resource.prlimit(fork_server, resource.RLIMIT_AS, (limit, hard))
        with pytest.raises(EngineError):
            race_v0.parallel_env(**{**OPTIONS, "track": "black_forest"}).reset(seed=1)
        if process_exists(fork_server):
            resource.prlimit(fork_server, resource.RLIMIT_AS, (hard, hard))
        assert trace(env) == expected


# ---------------------------------------------------------------------- clocks

PACKAGE = Path(stkzoo.__file__).parent
#: Modules that read the time of day: it shows the age of an abandoned folder.
KNOWN = {"engine/assets/staging.py"}
WALL = {"time.time", "time.time_ns", "datetime.now", "datetime.utcnow", "datetime.datetime.now"}


def test_no_time_limit_depends_on_the_time_of_day():
    users = set()
    for file in PACKAGE.rglob("*.py"):
        calls = (node for node in ast.walk(ast.parse(file.read_text())) if is_call(node))
        if WALL & {ast.unparse(node.func) for node in calls}:
            users.add(str(file.relative_to(PACKAGE)))
    assert users == KNOWN


def is_call(node):
    return isinstance(node, ast.Call)


#: Shifts the time of day, and no other clock, by the seconds in a file.
JUMPER = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static long offset(void) {
    char text[32] = {0};
    int file = open(getenv("CHAOS_CLOCK"), O_RDONLY | O_CLOEXEC);
    if (file < 0 || read(file, text, sizeof text - 1) < 0) text[0] = 0;
    if (file >= 0) close(file);
    return atol(text);
}

int clock_gettime(clockid_t id, struct timespec *now) {
    int (*real)(clockid_t, struct timespec *) = dlsym(RTLD_NEXT, "clock_gettime");
    int result = real(id, now);
    if (!result && id == CLOCK_REALTIME) now->tv_sec += offset();
    return result;
}

int gettimeofday(struct timeval *now, void *zone) {
    struct timespec exact;
    (void)zone;
    if (clock_gettime(CLOCK_REALTIME, &exact)) return -1;
    now->tv_sec = exact.tv_sec, now->tv_usec = exact.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *now) {
    struct timespec exact;
    clock_gettime(CLOCK_REALTIME, &exact);
    if (now) *now = exact.tv_sec;
    return exact.tv_sec;
}
"""


@pytest.fixture
def jumping_clock(tmp_path):
    """Returns environment variables that give a program a shifted clock, which a file controls."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("a clock that jumps needs a C compiler")
    source, clock = tmp_path / "jumper.c", tmp_path / "clock"
    source.write_text(JUMPER)
    clock.write_text("0")
    words = [compiler, "-shared", "-fPIC", "-o", str(tmp_path / "jumper.so"), str(source), "-ldl"]
    subprocess.run(words, check=True)
    return {"LD_PRELOAD": str(tmp_path / "jumper.so"), "CHAOS_CLOCK": str(clock)}


def test_clock_changes_have_no_effect(jumping_clock):
    """Runs a race and an isolated agent while the clock jumps back and forth by days."""
    code = f"""
        import os, time
        from pathlib import Path
        from stkzoo import race_v0
        from stkzoo.race import RaceListener, run_race
        from tests.chaos.forms import digest
        begin, jumps = time.time(), set()

        def jump(number):
            days = (-5, 9, 0, -700)[number % 4]
            Path(os.environ["CHAOS_CLOCK"]).write_text(str(days * 86400))
            jumps.add(round((time.time() - begin) / 86400))

        class Jumping(RaceListener):
            def stepped(self, race):
                jump(race.steps)

        env = race_v0.parallel_env(**{OPTIONS!r}, engine_timeout=5.0)
        for number in range(3):
            jump(number)
            parts = [env.reset(seed=1)]
            for step in range(20):
                jump(step)
                parts.append(env.step(dict.fromkeys(env.agents, 700)))
        agent = {str(AGENTS / "plain")!r}
        result = run_race([agent, "ai"], track="olivermath", max_steps=40, listeners=[Jumping()])
        print(sorted(jumps), result.steps, result.has_errors, digest(parts))
    """
    path = str(ROOT)
    done = run_program(code, env={**os.environ, **jumping_clock, "PYTHONPATH": path})
    with make() as env:
        expected = trace(env)
    assert done.stdout.strip() == f"[-700, -5, 0, 9] 40 False {expected}", done.stderr


# ---------------------------------------------------------------------- processes and threads

WORKERS = """
import multiprocessing, sys
from stkzoo import race_v0
from tests.chaos.forms import digest

def make():
    return race_v0.parallel_env(num_kart=2, track="olivermath", view="flattened_discrete")

def trace(env):
    seen = [env.reset(seed=1)]
    seen += [env.step(dict.fromkeys(env.agents, 700)) for _ in range(20)]
    return digest(seen)

def work(answers):
    with make() as env:
        answers.put(trace(env))

if __name__ == "__main__":
    context = multiprocessing.get_context(sys.argv[1])
    mine = make()
    expected = trace(mine)
    mine.reset(seed=2)
    answers = context.Queue()
    workers = [context.Process(target=work, args=(answers,), daemon=True) for _ in range(2)]
    for worker in workers:
        worker.start()
    mine.step(dict.fromkeys(mine.agents, 700))
    print([answers.get(timeout=60) == expected for _ in workers], trace(mine) == expected)
    for worker in workers:
        worker.join()
"""


@pytest.mark.parametrize("method", ["fork", "forkserver", "spawn"])
@pytest.mark.filterwarnings("ignore")
def test_daemonic_workers_of_every_start_method_run_the_same_race(tmp_path, method):
    file = tmp_path / "workers.py"
    file.write_text(WORKERS)
    variables = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(file), method]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=variables)
    assert done.stdout.strip() == "[True, True] True", done.stderr


def test_an_environment_can_move_between_threads():
    results = []

    def in_thread(work):
        thread = threading.Thread(target=lambda: results.append(work()))
        thread.start()
        thread.join()
        return results.pop()

    fork_client._close_all()  # so that the fork server becomes a child of a thread that ends
    env = in_thread(make)
    first = in_thread(lambda: trace(env))
    assert in_thread(lambda: trace(env)) == first
    assert trace(env) == first
    pid = env._session.pid
    in_thread(env.close)
    assert wait_until(lambda: not process_exists(pid))


def test_races_in_threads_recover_when_they_are_killed():
    with make() as env:
        expected = trace(env)
    fork_server, stop, lost = fork_server_of_races()._process.pid, threading.Event(), []

    def race():
        with make() as env:
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
