"""Under floods, a server bounds its connections, memory and logs, and still serves races."""

import os
import socket
import subprocess
import sys
import threading
import time

import pytest
import zmq

from stkzoo.drivers.driver import find_driver
from stkzoo.race.remote import RaceServer, peers
from stkzoo.race.remote.protocol import HELLO, VERSION, pack
from stkzoo.race.remote.sockets import UnreadData
from tests.fuzz.messages import resident_memory
from tests.support.floods import (
    HALF_GREETING,
    PING,
    IdleClients,
    allow_descriptors,
    connect_all,
    limited_server,
    num_descriptors,
    num_open,
    remote_race,
    reset_at_once,
    send_until_closed,
    zmtp_frame,
    zmtp_socket,
)
from tests.support.processes import wait_until
from tests.support.remote_race import raw_client, server_process, server_thread

GREETING = {
    "HTTP": b"GET / HTTP/1.1\r\nHost: a\r\n\r\n",
    "zeros": b"\0" * 4096,
    "ones": b"\xff" * 4096,
    "half": HALF_GREETING,
    "another mechanism": b"\xff" + b"\0" * 8 + b"\x7f\x03\x01PLAIN" + b"\0" * 47,
    "a long command": HALF_GREETING.ljust(64, b"\0") + b"\x06" + b"\xff" * 8,
}


def plain(address):
    host, port = address.removeprefix("tcp://").rsplit(":", 1)
    return host, int(port)


@pytest.fixture
def held():
    sockets = []
    yield sockets
    for one in sockets:
        one.close()


@pytest.mark.slow
def test_a_race_is_served_despite_many_idle_clients():
    """For the full test with 1,200 clients: ``python -m benchmarks.floods``."""
    allow_descriptors(2000)
    with limited_server("heuristic", descriptors=256, stderr=subprocess.PIPE) as (server, address):
        with IdleClients(address, 300) as clients:
            heard = clients.hear(1.5)
            assert num_descriptors(server.pid) < 160
            assert any("too many connections" in str(kind) for kind in heard)
            assert remote_race(address) == []
        assert remote_race(address) == []
        server.terminate()
        log = server.stderr.read()
    assert "Traceback" not in log
    assert len(log.splitlines()) < 30


def test_an_idle_connection_times_out(monkeypatch):
    monkeypatch.setattr(peers, "IDLE", 0.2)
    with server_thread([find_driver("heuristic")]) as server:
        with raw_client(server.address) as client:
            client.send_multipart([HELLO, pack(protocol=VERSION)])
            assert client.recv_multipart()[0] == b"W"
            kind, body = client.recv_multipart()
            assert (kind, b"had no race for" in body) == (b"E", True)
        assert remote_race(server.address) == []


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says how much came")
def test_an_idle_connection_that_sends_more_than_64_kb_is_cut_off():
    with server_thread([find_driver("heuristic")]) as server, zmtp_socket(server.address) as one:
        one.sendall(PING * (1 + (64 << 10) // len(PING)))
        assert wait_until(lambda: not num_open([one]))


def test_a_message_of_many_frames_is_discarded_in_parts_and_its_sender_is_disconnected():
    """Other clients are served between the parts."""
    with (
        RaceServer([find_driver("heuristic")], "127.0.0.1:*") as server,
        zmtp_socket(server.address) as one,
    ):
        one.sendall(zmtp_frame(b"H", more=True) + zmtp_frame(b"", more=True) * 3000)
        one.sendall(zmtp_frame(b""))
        assert server._socket.poll(10_000)
        server._update_peers()
        server._receive()
        assert server._socket.getsockopt(zmq.RCVMORE)
        assert wait_until(lambda: not num_open([one]))
        for _ in range(3):
            server._receive()
        assert not server._socket.getsockopt(zmq.RCVMORE)


def test_a_connection_with_a_race_can_be_silent(monkeypatch):
    monkeypatch.setattr(peers, "IDLE", 0.2)
    with server_thread([find_driver("heuristic")]) as server, raw_client(server.address) as client:
        opening = pack(protocol=VERSION, seat=0, driver=0, agent="a", extras=[], seed=1)
        client.send_multipart([b"O", opening])
        time.sleep(1.0)
        kinds = []
        while client.poll(0):
            kinds.append(client.recv_multipart()[0])
        assert kinds == [b"P"]


@pytest.mark.parametrize("name", GREETING)
def test_bytes_that_are_not_zeromq_do_not_affect_a_race(name, held):
    with server_thread([find_driver("heuristic")]) as server:
        connect_all(plain(server.address), 30, GREETING[name], held)
        assert remote_race(server.address, steps=3) == []


def test_clients_that_reset_immediately_leave_no_open_descriptors():
    with server_process("random", "--quiet") as (process, address):
        assert remote_race(address, steps=3) == []
        before = num_descriptors(process.pid)
        reset_at_once(plain(address), 500)
        assert remote_race(address, steps=3) == []
        assert wait_until(lambda: num_descriptors(process.pid) <= before)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says how much came")
def test_an_endless_message_is_cut_off():
    with server_process("random", "--quiet") as (process, address):
        before = resident_memory(process.pid)
        with zmtp_socket(address) as one:
            assert send_until_closed(one, zmtp_frame(bytes(1 << 20), more=True), 120.0)
        assert remote_race(address, steps=3) == []
        assert resident_memory(process.pid) - before < 1 << 30


@pytest.mark.slow
def test_endless_heartbeats_do_not_stop_a_race():
    with server_process("random", "--quiet") as (process, address), zmtp_socket(address) as one:
        before = resident_memory(process.pid)
        flood = threading.Thread(target=send_until_closed, args=(one, PING * 1000, 3.0))
        flood.start()
        assert remote_race(address) == []
        flood.join()
        assert resident_memory(process.pid) - before < 64 << 20


def test_clients_with_the_same_identity_do_not_disturb_a_race():
    with server_thread([find_driver("random")]) as server:
        hello = zmtp_frame(HELLO, more=True) + zmtp_frame(pack(protocol=VERSION))
        twins = [zmtp_socket(server.address, b"twin") for _ in range(20)]
        for twin in twins:
            twin.sendall(hello)
        assert remote_race(server.address, steps=3) == []
        for twin in twins:
            twin.close()


def test_only_the_intended_connection_is_cut():
    left, right = socket.socketpair()
    with server_thread([find_driver("random")]) as server:
        peer = peers._Peer(("127.0.0.1", "another"), "", 0.0)
        server._peers._shut(left.fileno(), peer)
    right.sendall(b"a")
    assert left.recv(1) == b"a"
    left.close()
    right.close()


def test_a_descriptor_that_now_belongs_to_a_file_is_not_opened_again_at_each_check(tmp_path):
    unread = UnreadData()
    with open(tmp_path / "file", "w") as file:
        before = num_descriptors(os.getpid())
        unread.connected(file.fileno())
        assert not unread.is_too_much()
        assert num_descriptors(os.getpid()) == before


def test_incomplete_greetings_do_not_hold_connections(held):
    with server_thread([find_driver("random")]) as server:
        connect_all(plain(server.address), 5, HALF_GREETING, held)
        assert num_open(held) == 5
        server._peers._most = 2
        assert remote_race(server.address, steps=3) == []
        assert wait_until(lambda: num_open(held) <= 2)
