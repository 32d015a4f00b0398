"""Isolated agents: a failing agent affects only its own kart (D23, D25)."""

import contextlib
import itertools
import os
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time

import pytest

from stkzoo.drivers import keeper
from stkzoo.race import RaceListener, run_race
from tests.support.paths import AGENTS
from tests.support.processes import children_of, measured, process_exists, wait_until

HOSTILE = AGENTS / "hostile"
TRACK = "lighthouse"


def hostile(name):
    return str(HOSTILE / f"{name}.py")


def race(*drivers, **settings):
    settings = {"track": TRACK, "seed": 1, "action_timeout": 1.0, **settings}
    return run_race(list(drivers), **settings)


def by_driver(result):
    return {row.driver: row for row in result.agents}


@pytest.fixture(scope="module")
def hostile_race():
    """Returns a race of four hostile and two good agents, up to the finish."""
    names = ("loop", "exits", "hungry", "shape")
    good = [str(AGENTS / "plain"), str(AGENTS / "alpha")]
    return race(*good, *map(hostile, names), agent_memory=2048)


@pytest.mark.slow
def test_good_agents_finish_alongside_hostile_ones(hostile_race):
    rows = by_driver(hostile_race)
    assert hostile_race.status == "finished"
    assert [rows[name].status for name in ("Plain", "Alpha")] == ["finished", "finished"]
    assert not rows["Plain"].num_errors
    assert not rows["Alpha"].num_errors


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind", "message"),
    [
        ("loop", "timeout", "its action took longer than 1 s; its process was ended"),
        ("exits", "error", "its process exited with code 1 when the action was due"),
        ("hungry", "error", "MemoryError"),
        ("shape", "error", "expected a number from -1.0 to 1.0"),
    ],
)
def test_a_hostile_agents_failure_is_reported(hostile_race, name, kind, message):
    row = by_driver(hostile_race)[name]
    assert row.status == "retired"
    assert [failure.kind for failure in row.errors] == [kind]
    assert message in row.errors[0].message


@pytest.mark.slow
@pytest.mark.parametrize("handling", ["retire", "restart", "catch"])
def test_a_race_ends_when_all_its_agents_have_failed(handling):
    drivers = map(hostile, ("closes", "forger", "unloadable", "no_actor"))
    result = race(*drivers, error_handling=handling, max_restarts=1, max_steps=50)
    assert result.status == "abandoned"
    assert all(row.status == "retired" for row in result.agents)
    assert result.steps < 10


@pytest.mark.slow
def test_the_race_does_not_wait_for_an_agent_that_never_loads():
    result = race("ai", hostile("sleeps"), start_timeout=2.0, max_steps=5)
    assert "its start took longer than 2 s" in by_driver(result)["sleeps"].errors[0].message
    assert result.steps == 5


@pytest.mark.slow
def test_output_printed_by_an_agent_is_harmless():
    result = race(hostile("noisy"), max_steps=40)
    assert not result.has_errors
    assert result.agents[0].distance > 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["closes", "forger"])
def test_an_agent_that_breaks_its_connection_is_retired(name):
    result = race(hostile(name), "ai", max_steps=5)
    assert by_driver(result)[name].num_errors == 1


@pytest.mark.slow
def test_an_agent_has_no_connection_other_than_its_own():
    """The forger writes to every socket of its process, and breaks only its own connection."""
    rows = by_driver(race(hostile("forger"), str(AGENTS / "plain"), "heuristic", max_steps=5))
    assert [rows[name].num_errors for name in ("forger", "Plain", "heuristic")] == [1, 0, 0]


@pytest.mark.slow
def test_an_agent_that_never_answers_delays_the_race_by_its_timeout_once():
    moments = []

    class Watcher(RaceListener):
        def started(self, _):
            moments.append(time.monotonic())

        stepped = started

    race(hostile("loop"), "ai", listeners=[Watcher()], action_timeout=0.5, max_steps=5)
    delays = [end - begin for begin, end in itertools.pairwise(moments)]
    assert len(delays) == 5
    assert 0.5 <= delays[0] < 10.0


@pytest.mark.slow
def test_a_memory_bomb_in_a_reply_is_not_decoded():
    """Decoding it would take 1 GB and minutes."""
    with measured() as cost:
        result = race(hostile("bomber"), str(AGENTS / "plain"), max_steps=5)
    rows = by_driver(result)
    assert "not a valid message" in rows["bomber"].errors[0].message
    assert not rows["Plain"].num_errors
    assert cost["memory"] < 200 << 20
    assert cost["seconds"] < 20


@pytest.mark.slow
def test_a_long_error_report_is_refused():
    result = race(hostile("talker"), "ai", max_steps=5)
    row = next(row for row in result.agents if row.num_errors)
    assert row.driver == "y" * 32
    assert len(row.errors[0].message) <= 4000
    assert len(row.errors[0].trace) <= 8000
    assert len(result.to_json()) < 50_000


@pytest.mark.slow
def test_retire_removes_an_agent_at_its_first_error():
    row = by_driver(race("ai", hostile("once"), max_steps=20))["once"]
    assert (row.status, row.num_errors, row.errors[0].step) == ("retired", 1, 2)


@pytest.mark.slow
def test_catch_lets_an_agent_continue_after_an_error():
    result = race(hostile("once"), error_handling="catch", max_steps=20)
    assert (result.agents[0].status, result.agents[0].num_errors) == ("racing", 1)


@pytest.mark.slow
def test_restart_restarts_an_agent_up_to_the_limit():
    result = race(hostile("once"), error_handling="restart", max_restarts=2, max_steps=50)
    assert [failure.step for failure in result.agents[0].errors] == [2, 5, 8]
    assert result.agents[0].status == "retired"


@pytest.mark.slow
def test_a_random_agent_repeats_with_the_seed():
    files = str(AGENTS / "module_home" / "bare_module_agent.py")
    results = [race(files, hostile("once"), error_handling="catch", max_steps=60) for _ in "ab"]
    assert results[0] == results[1]
    assert race(files, hostile("once"), error_handling="catch", seed=2, max_steps=60) != results[0]


@pytest.mark.slow
def test_isolated_and_inline_agents_give_the_same_race():
    drivers = [str(AGENTS / name) for name in ("plain", "alpha", "beta", "wrapped", "weights")]
    settings = {"max_steps": 120, "action_timeout": 60.0}
    isolated = race(*drivers, **settings)
    assert isolated == race(*drivers, **settings, inline=True)
    assert min(row.distance for row in isolated.agents) > 10


@pytest.mark.slow
def test_an_inline_agent_that_is_too_late_is_ended():
    result = race(hostile("loop"), "ai", inline=True, action_timeout=0.3, max_steps=9)
    assert "its action took longer than 0.3 s" in by_driver(result)["loop"].errors[0].message


@pytest.mark.slow
def test_an_agents_processes_do_not_outlive_the_race(monkeypatch, tmp_path):
    pids = tmp_path / "pids"
    monkeypatch.setenv("STKZOO_TEST_PIDS", str(pids))
    assert not race(hostile("parent"), sandbox="off", max_steps=3).has_errors
    for pid in map(int, pids.read_text().split()):
        assert wait_until(lambda pid=pid: not process_exists(pid))


@pytest.mark.slow
def test_an_agent_ends_when_its_race_is_killed(tmp_path):
    pids = tmp_path / "pids"
    code = f"""
        from stkzoo.race import run_race
        run_race([{hostile("parent")!r}], track={TRACK!r}, max_steps=10**6, sandbox="off")
    """
    program = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)],
        env={**os.environ, "STKZOO_TEST_PIDS": str(pids)},
        start_new_session=True,
    )
    try:
        assert wait_until(lambda: pids.exists() and len(pids.read_text().split()) == 2, 30)
    finally:
        program.kill()
        program.wait()
    agent, child = map(int, pids.read_text().split())
    assert wait_until(lambda: not process_exists(agent) and not process_exists(child))


def left_by_this_program():
    return threading.active_count(), len(os.listdir("/proc/self/fd")), children_of(os.getpid())


@pytest.mark.slow
def test_an_agents_daemon_does_not_outlive_the_race(monkeypatch, tmp_path):
    """The daemon leaves its session and its parents, and keeps the agent's output open."""
    pids = tmp_path / "pids"
    monkeypatch.setenv("STKZOO_TEST_PIDS", str(pids))
    race("ai", hostile("daemon"), sandbox="off", max_steps=3)
    before = left_by_this_program()
    for _ in range(3):
        race("ai", hostile("daemon"), sandbox="off", max_steps=3)
    assert left_by_this_program() == before
    daemons = [int(pid) for pid in pids.read_text().split()]
    assert len(daemons) == 4
    assert wait_until(lambda: not any(map(process_exists, daemons)))


@contextlib.contextmanager
def kept(program, cores=""):
    """Runs a program as an agent; yields its keeper's process and the race's end of its socket."""
    race_end, keeper_end = socket.socketpair()
    arguments = [str(os.getpid()), str(keeper_end.fileno()), str(4 << 30), cores]
    agent = [sys.executable, "-S", "-c", textwrap.dedent(program)]
    with race_end, keeper_end:
        process = subprocess.Popen(
            [sys.executable, "-I", "-S", keeper.__file__, *arguments, *agent],
            stdin=keeper_end,
            stdout=subprocess.PIPE,
            pass_fds=[keeper_end.fileno()],
        )
        race_end.settimeout(20)
        try:
            yield process, race_end
        finally:
            race_end.close()
            process.stdout.close()
            process.wait()


@pytest.mark.parametrize(
    ("processes", "statement", "excess"),
    [
        (9, "[os.dup(0) for _ in range(950)]", "8192 files"),
        (3, "[os.pipe() for _ in range(100)]", "256 pipes"),
        (
            5,
            "[start_new_thread(time.sleep, (99,)) for _ in range(120)]",
            "started more than 512 thr",
        ),
    ],
)
def test_a_keeper_ends_an_agent_whose_processes_use_too_much(processes, statement, excess):
    """The number of files limits the keeper's work; Linux counts pipes and threads per user."""
    program = f"""
        import os, time
        from _thread import start_new_thread, stack_size
        stack_size(1 << 16)
        for _ in range({processes}):
            if not os.fork():
                kept = {statement}
                break
        time.sleep(100)
    """
    with kept(program) as (_, life):
        assert excess in life.recv(200).decode()


def test_a_keeper_runs_on_the_cores_of_its_agent():
    core = max(os.sched_getaffinity(0))
    program = """
        import os, time
        print(os.sched_getaffinity(0), flush=True)
        time.sleep(100)
    """
    with kept(program, str(core)) as (process, _):
        assert process.stdout.readline().decode() == f"{{{core}}}\n"
        assert os.sched_getaffinity(process.pid) == {core}


@pytest.mark.slow
def test_a_daemon_of_an_agent_that_kills_its_keeper_outlives_the_race(monkeypatch, tmp_path):
    """The page on the threat model says so; a sandbox prevents it."""
    pids = tmp_path / "pids"
    monkeypatch.setenv("STKZOO_TEST_PIDS", str(pids))
    race("ai", hostile("escapes"), sandbox="off", max_steps=3, start_timeout=5.0)
    (daemon,) = map(int, pids.read_text().split())
    assert process_exists(daemon)
    os.kill(daemon, signal.SIGKILL)


@pytest.mark.slow
def test_the_memory_limit_covers_all_processes_of_an_agent(monkeypatch, tmp_path):
    """The system's limit on a process's data covers only its own memory.

    The sandbox refuses shared memory, so this race has none.
    """
    monkeypatch.setenv("STKZOO_TEST_PIDS", str(tmp_path / "pids"))
    limits = {"sandbox": "off", "agent_memory": 400, "action_timeout": 20.0}
    for name in ("shares", "spreads", "tables"):
        row = by_driver(race("ai", hostile(name), **limits, max_steps=40))[name]
        assert "used more than 400 MB with all its processes" in row.errors[0].message
