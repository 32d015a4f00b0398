"""Under floods, a server bounds its connections and logs, and its races continue."""

import subprocess

import pytest

from stkzoo.drivers.driver import find_driver
from stkzoo.race import RaceListener, run_race
from stkzoo.race.remote import RemoteDriverGroup
from tests.support.floods import (
    HALF_GREETING,
    connect_all,
    limited_server,
    num_descriptors,
    num_open,
    remote_race,
    reset_at_once,
)
from tests.support.processes import wait_until
from tests.support.remote_race import server_process, server_thread

GREETING = {
    "HTTP": b"GET / HTTP/1.1\r\nHost: a\r\n\r\n",
    "half": HALF_GREETING,
    "another mechanism": b"\xff" + b"\0" * 8 + b"\x7f\x03\x01PLAIN" + b"\0" * 47,
}


def plain(address):
    host, port = address.removeprefix("tcp://").rsplit(":", 1)
    return host, int(port)


@pytest.mark.slow
def test_a_server_bounds_its_connections_and_listens_again_when_they_end(held):
    """Incomplete handshakes end after 5 s. A race that has begun continues meanwhile."""
    with (
        limited_server("heuristic", descriptors=256, stderr=subprocess.PIPE) as (server, address),
        RemoteDriverGroup([address]) as group,
    ):

        class Flood(RaceListener):
            def started(self, _):
                connect_all(plain(address), 300, HALF_GREETING, held)

        result = run_race(
            [*group.drivers, "ai"],
            track="lighthouse",
            seed=1,
            max_steps=20,
            listeners=[Flood()],
        )
        assert not result.has_errors
        assert num_descriptors(server.pid) < 160
        assert wait_until(lambda: num_open(held) == 0, 20)
        assert remote_race(address) == []
        server.terminate()
        log = server.stderr.read()
    assert "too many connections" in log
    assert "Traceback" not in log


@pytest.mark.parametrize("name", GREETING)
def test_bytes_that_are_not_zeromq_do_not_affect_a_race(name, held):
    with server_thread([find_driver("heuristic")]) as server:
        connect_all(plain(server.address), 30, GREETING[name], held)
        assert remote_race(server.address, steps=3) == []


@pytest.mark.slow
def test_clients_that_reset_immediately_leave_no_open_descriptors():
    with server_process("random", "--quiet") as (process, address):
        assert remote_race(address, steps=3) == []
        before = num_descriptors(process.pid)
        reset_at_once(plain(address), 500)
        assert remote_race(address, steps=3) == []
        assert wait_until(lambda: num_descriptors(process.pid) <= before)
