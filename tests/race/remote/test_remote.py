"""Races with agents on servers: the real engine, real processes, real sockets."""

import os
import signal
import subprocess
import sys
import time

import pytest

from stkzoo.drivers.messages import Ready
from stkzoo.errors import ConfigError, RemoteError
from stkzoo.race import RaceListener, find_driver, run_race
from stkzoo.race.remote import RaceServer, RemoteDriverGroup, sockets
from stkzoo.race.remote import server as server_module
from stkzoo.race.remote.protocol import Refused, read_reply
from tests.support.remote_race import (
    open_request,
    raw_client,
    server_process,
    server_thread,
    write_agent,
)

TRACK = {"track": "lighthouse", "seed": 3}


def rows(result):
    return {row.agent: row for row in result.agents}


def essence(result):
    return [
        (row.agent, row.rank, row.finish_time, row.distance, row.reward) for row in result.agents
    ]


class Watcher(RaceListener):
    """Calls a function once, after a number of steps."""

    def __init__(self, step, deed):
        self._step, self._deed = step, deed

    def stepped(self, race):
        if race.steps == self._step:
            self._deed()


@pytest.mark.slow
def test_a_race_over_two_servers_matches_the_local_race():
    with (
        server_process("heuristic") as (_, first),
        server_process("heuristic") as (_, second),
        RemoteDriverGroup([first, second]) as group,
    ):
        assert [driver.name for driver in group.drivers] == ["heuristic", "heuristic"]
        result = run_race([*group.drivers, "ai"], **TRACK)
    assert all(row.finish_time for row in result.agents)
    assert all(not row.errors for row in result.agents)
    assert essence(result) == essence(run_race(["heuristic", "heuristic", "ai"], **TRACK))


@pytest.mark.slow
def test_one_server_drives_several_agents_in_any_order(tmp_path):
    names = ["ada", "bob", "eve"]
    agents = [write_agent(tmp_path, name) for name in names]
    with server_process(*agents) as (_, address), RemoteDriverGroup([address]) as group:
        for order in ([0, 1, 2], [2, 0, 1]):
            drivers = [group.drivers[number] for number in order]
            result = run_race([*drivers, "heuristic"], max_steps=15, **TRACK)
            seats = rows(result)
            assert [seats[f"kart_{k}"].driver for k in range(3)] == [names[k] for k in order]
            assert not any(row.errors for row in result.agents)


@pytest.mark.slow
def test_inline_agents_of_a_server_have_their_own_modules(tmp_path):
    """The threads of the server take turns, because a program has one table of modules."""
    drivers = []
    for name in ("ada", "bob"):
        agent = write_agent(tmp_path, name, f"import helper; assert helper.NAME == {name!r}")
        (tmp_path / name / "helper.py").write_text(f"NAME = {name!r}\n")
        drivers.append(find_driver(agent, inline=True))
    with server_thread(drivers) as server, RemoteDriverGroup([server.address]) as group:
        result = run_race(group.drivers * 3, max_steps=30, **TRACK)
    assert not result.has_errors


@pytest.mark.slow
def test_a_server_killed_during_a_race_loses_only_its_own_karts():
    with (
        server_process("heuristic") as (process, first),
        server_process("heuristic") as (_, second),
        RemoteDriverGroup([first, second]) as group,
    ):
        killer = Watcher(30, lambda: process.send_signal(signal.SIGKILL))
        result = run_race(group.drivers, listeners=[killer], error_handling="retire", **TRACK)
    lost, other = rows(result)["kart_0"], rows(result)["kart_1"]
    assert "the connection to" in lost.errors[0].message
    assert lost.finish_time is None
    assert other.finish_time
    assert not other.errors


@pytest.mark.slow
def test_a_stopped_server_affects_only_its_own_karts():
    with (
        server_process("heuristic") as (process, first),
        server_process("heuristic") as (_, second),
        RemoteDriverGroup([first, second], timeout=1.0) as group,
    ):
        stopper = Watcher(10, lambda: process.send_signal(signal.SIGSTOP))
        result = run_race(group.drivers, listeners=[stopper], max_steps=30, **TRACK)
    assert "did not answer in time" in rows(result)["kart_0"].errors[0].message
    assert not rows(result)["kart_1"].errors


@pytest.mark.slow
def test_a_server_restarted_between_races_serves_the_next_race(tmp_path):
    agent = write_agent(tmp_path, "ada")
    with server_process(agent) as (_, address):
        group = RemoteDriverGroup([address])
        run_race(group.drivers, max_steps=5, **TRACK)
    with group, server_process(agent, address=address.removeprefix("tcp://")):
        result = run_race(group.drivers, max_steps=5, **TRACK)
    assert not any(row.errors for row in result.agents)


@pytest.mark.slow
def test_a_slow_agent_is_stopped_and_its_servers_other_agents_continue(tmp_path):
    slow = write_agent(tmp_path, "slow", act="import time; time.sleep(3600)")
    good = write_agent(tmp_path, "good")
    with (
        server_process(slow, good, "--action-timeout", "0.5") as (_, address),
        RemoteDriverGroup([address]) as group,
    ):
        result = run_race(group.drivers, max_steps=20, **TRACK)
    assert "longer than 0.5 s" in rows(result)["kart_0"].errors[0].message
    assert not rows(result)["kart_1"].errors


@pytest.mark.slow
def test_the_client_can_set_a_shorter_time_limit_than_the_server(tmp_path):
    slow = write_agent(tmp_path, "slow", act="import time; time.sleep(60)")
    with server_process(slow) as (_, address), RemoteDriverGroup([address]) as group:
        result = run_race([*group.drivers, "ai"], max_steps=10, action_timeout=0.3, **TRACK)
    assert "longer than 0.3 s" in rows(result)["kart_0"].errors[0].message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("act", "text"),
    [("raise KeyError('oops')", "oops"), ("import os; os._exit(1)", "exited with code 1")],
)
def test_a_failing_agent_does_not_harm_its_server(tmp_path, act, text):
    bad, good = write_agent(tmp_path, "bad", act), write_agent(tmp_path, "good")
    with server_process(bad, good) as (_, address), RemoteDriverGroup([address]) as group:
        for _ in range(2):
            result = run_race(group.drivers, max_steps=8, **TRACK)
            failure = rows(result)["kart_0"].errors[0]
            assert text in failure.message
            assert not rows(result)["kart_1"].errors


@pytest.mark.slow
def test_an_agent_that_fails_to_load_affects_only_itself(tmp_path):
    bad, good = write_agent(tmp_path, "bad"), write_agent(tmp_path, "good")
    with open(os.path.join(bad, "pystk_actor.py"), "w") as file:
        file.write("import no_such_module\n")
    with server_process(bad, good) as (_, address), RemoteDriverGroup([address]) as group:
        result = run_race(group.drivers, max_steps=8, **TRACK)
    assert "no_such_module" in rows(result)["kart_0"].errors[0].message
    assert not rows(result)["kart_1"].errors


@pytest.mark.slow
def test_one_server_serves_two_races_at_once():
    with (
        server_thread([find_driver("heuristic")]) as server,
        RemoteDriverGroup([server.address]) as group,
        RemoteDriverGroup([server.address]) as other,
    ):
        inner = []

        def race_between():
            inner.append(run_race([*other.drivers, "ai"], max_steps=20, **TRACK))

        outer = run_race(
            [*group.drivers, "ai"], listeners=[Watcher(10, race_between)], max_steps=20, **TRACK
        )
    assert essence(outer) == essence(inner[0])


@pytest.mark.slow
def test_a_full_server_refuses_another_race():
    with (
        server_thread([find_driver("heuristic")], max_sessions=1) as server,
        RemoteDriverGroup([server.address]) as group,
        RemoteDriverGroup([server.address]) as other,
    ):
        late = []

        def race_between():
            late.append(run_race([*other.drivers, "ai"], max_steps=3, **TRACK))

        result = run_race(
            [*group.drivers, "ai"], listeners=[Watcher(2, race_between)], max_steps=5, **TRACK
        )
        assert not any(row.errors for row in result.agents)
        assert "all of its 1 sessions" in rows(late[0])["kart_0"].errors[0].message
        for _ in range(3):  # the server is free again immediately
            again = run_race([*other.drivers, "ai"], max_steps=3, **TRACK)
            assert not any(row.errors for row in again.agents)


@pytest.mark.slow
def test_a_disconnected_client_frees_its_place(tmp_path):
    agent = write_agent(tmp_path, "ada")
    code = (
        "import os\n"
        "from stkzoo.race import run_race\n"
        "from stkzoo.race.remote import RemoteDriverGroup\n"
        "from tests.race.remote.test_remote import Watcher\n"
        "import sys\n"
        "group = RemoteDriverGroup([sys.argv[1]])\n"
        "run_race(group.drivers, track='lighthouse', listeners=[Watcher(3, lambda: os._exit(7))])\n"
    )
    with server_process(agent, "--threads", "1") as (_, address):
        command = [sys.executable, "-c", code, address]
        assert subprocess.run(command, timeout=60).returncode == 7
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline:
            with RemoteDriverGroup([address]) as group:
                result = run_race(group.drivers, max_steps=3, **TRACK)
            if not result.agents[0].errors:
                return
            time.sleep(0.5)
    pytest.fail("the server still kept the place of a client that is gone")


@pytest.mark.slow
def test_a_silent_client_loses_its_place(monkeypatch):
    monkeypatch.setattr(server_module, "_PATIENCE", 0.2)
    with (
        server_thread([find_driver("heuristic")], max_sessions=1) as server,
        raw_client(server.address) as client,
    ):
        client.send(open_request())
        assert isinstance(read_reply(client.recv_multipart()), Ready)
        refused = read_reply(client.recv_multipart())
        assert refused == Refused("no message from the client for 0.2 s")
        monkeypatch.undo()
        with RemoteDriverGroup([server.address]) as group:
            assert not run_race([*group.drivers, "ai"], max_steps=3, **TRACK).has_errors


@pytest.mark.slow
def test_a_paused_client_continues(monkeypatch):
    """Its heartbeats go on."""
    for option, milliseconds in (("IVL", 50), ("TIMEOUT", 200), ("TTL", 200)):
        monkeypatch.setitem(sockets._LIMITS, f"HEARTBEAT_{option}", milliseconds)
    with (
        server_thread([find_driver("heuristic")]) as server,
        RemoteDriverGroup([server.address]) as group,
    ):
        pause = Watcher(2, lambda: time.sleep(2.0))
        result = run_race([*group.drivers, "ai"], listeners=[pause], max_steps=5, **TRACK)
    assert not result.has_errors


@pytest.mark.slow
def test_a_missing_server_is_an_error_before_the_race():
    with pytest.raises(RemoteError, match="did not connect in time"):
        RemoteDriverGroup(["127.0.0.1:9"], connect_timeout=0.5)


@pytest.mark.parametrize("address", ["", "udp://a:1", "a:b", "a:99999", "tcp://", "ipc://"])
def test_an_invalid_address_is_refused(address):
    with pytest.raises(ConfigError, match="expected one such as"):
        RaceServer([find_driver("heuristic")], address)


def test_a_server_refuses_the_games_own_ai():
    with pytest.raises(ConfigError, match="name at least one"):
        RaceServer([], "127.0.0.1:*")
    with pytest.raises(ConfigError, match="name it on the client"):
        RaceServer([find_driver("ai")], "127.0.0.1:*")


def test_an_address_in_use_is_an_error():
    with (
        server_thread([find_driver("heuristic")]) as server,
        pytest.raises(ConfigError, match="cannot listen"),
    ):
        RaceServer([find_driver("heuristic")], server.address)
