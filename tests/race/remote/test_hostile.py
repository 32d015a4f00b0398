"""Clients and servers that do not keep to the protocol."""

import os
import random
import re
import sys
import threading
import time

import numpy as np
import pytest

from stkzoo.drivers.codec import encode
from stkzoo.errors import RemoteError
from stkzoo.race import RaceListener, find_driver, run_race
from stkzoo.race.remote import RemoteDriverGroup
from stkzoo.race.remote.connection import Server
from stkzoo.race.remote.drivers import ServedAgent
from stkzoo.race.remote.protocol import VERSION, pack, unpack
from tests.fuzz.messages import bad_messages, flood, resident_memory
from tests.support.bombs import bomb
from tests.support.floods import endless_server
from tests.support.paths import AGENTS
from tests.support.processes import measured, wait_until
from tests.support.remote_race import (
    LyingServer,
    raw_client,
    server_process,
    server_thread,
    write_agent,
)

pytestmark = pytest.mark.slow

TRACK = {"track": "lighthouse", "seed": 3}


def assert_serves(address):
    with RemoteDriverGroup([address]) as group:
        result = run_race([*group.drivers, "ai"], max_steps=10, **TRACK)
    assert not any(row.errors for row in result.agents)


def test_a_server_survives_thousands_of_invalid_messages():
    """To send 100,000 messages: ``python -m tests.fuzz.flood 100000``."""
    with server_process("heuristic", "--quiet") as (process, address):
        assert_serves(address)
        messages = bad_messages(random.Random(1))
        with raw_client(address) as socket:
            flood(socket, messages, 500)
        before = resident_memory(process.pid)
        for _ in range(5):
            with raw_client(address) as socket:
                flood(socket, messages, 500)
        assert_serves(address)
        assert resident_memory(process.pid) - before < 64 << 20


def test_a_client_sees_the_failing_lines_and_the_last_output_of_an_agent(tmp_path):
    agent = write_agent(tmp_path, "plain", act='print("in the log"); 1 / len("")  # in the code')
    with server_process(agent) as (_, address), RemoteDriverGroup([address]) as group:
        result = run_race([*group.drivers, "ai"], max_steps=2, **TRACK)
    trace = next(row.errors[0].trace for row in result.agents if row.errors)
    assert 'print("in the log"); 1 / len("")  # in the code' in trace
    assert "last output:\nin the log" in trace


def test_an_oversized_message_closes_only_its_connection():
    with server_thread([find_driver("heuristic")]) as server:
        with raw_client(server.address) as socket:
            socket.send_multipart([b"H", os.urandom(5 << 20)])
            assert not socket.poll(300)
        assert_serves(server.address)


@pytest.mark.parametrize(
    ("frames", "text"),
    [
        ([b"H"], "received 1 frames"),
        ([b"H", b"a", b"b", b"c"], "received 3 frames"),
        ([b"H", b"\x01"], "got int, expected dict"),
        ([b"H", pack(protocol=99)], f"speaks protocol 99, this one {VERSION}"),
        ([b"H", pack(protocol=np.zeros(3))], "protocol is array"),
        ([b"H", pack(protocol=VERSION, more=b"a" * 5000)], "expected at most 4096"),
        ([b"A", pack(step=1, observations=[])], "expected one of H, O first"),
        ([b"?", b""], "expected one of H, O first"),
        ([b"O", b"\xc1"], "not a valid message"),
        ([b"O", pack(protocol=VERSION)], "seat is None"),
        ([b"O", pack(protocol=VERSION, seat=True, driver=0)], "seat is True"),
        ([b"O", pack(protocol=VERSION, seat=0, driver=7)], "driver 7, expected 0 to 0"),
        ([b"O", pack(protocol=VERSION, seat=0, driver=-1)], "driver -1"),
        ([b"O", pack(protocol=VERSION, seat=0, driver=0, extras=[])], "agent is None"),
        ([b"O", pack(protocol=VERSION, seat=0, driver=0, agent="a")], "extras is None"),
        (
            [b"O", pack(protocol=VERSION, seat=0, driver=0, agent="a", extras=["x"])],
            "some of ground",
        ),
    ],
    ids=lambda value: str(value)[:30],
)
def test_an_invalid_message_gets_an_answer_that_explains_the_error(frames, text):
    with server_thread([find_driver("heuristic")]) as server:
        with raw_client(server.address) as socket:
            socket.send_multipart(frames)
            kind, body = socket.recv_multipart()
        assert kind == b"E"
        assert text in unpack(body)["text"]
        assert_serves(server.address)


def test_a_client_cannot_access_the_seats_of_another_client():
    with (
        server_thread([find_driver("heuristic")]) as server,
        RemoteDriverGroup([server.address]) as group,
        raw_client(server.address) as socket,
    ):
        done = threading.Event()

        def disturb():
            while not done.wait(0.005):
                socket.send_multipart([b"C", pack(seats=[0])])
                socket.send_multipart([b"A", pack(step=1, observations=[[0, encode(1)]])])
                socket.send_multipart([b"B", b""])
                while socket.poll(0):
                    socket.recv_multipart()

        thread = threading.Thread(target=disturb)
        thread.start()
        result = run_race([*group.drivers, "ai"], max_steps=30, **TRACK)
        done.set()
        thread.join()
    assert not any(row.errors for row in result.agents)


OPENED = pack(seat=0, name="liar", paths_used=None)
ACTION = {
    "acceleration": [1.0],
    "steer": [0.0],
    **dict.fromkeys(("brake", "drift", "fire", "nitro", "rescue"), 0),
}


def lies(*frames, **fields):
    """Returns a function that opens the seat correctly, then answers with frames or fields."""

    def lie(kind, asked):
        if kind == b"O":
            return [b"P", OPENED]
        answer = {
            "step": asked["step"],
            "decisions": [[0, encode(ACTION), 0.1, False]],
            "failures": [],
        }
        return [*frames] or [b"D", pack(**{**answer, **fields})]

    return lie


LIES = {
    "garbage": (lies(b"D", b"\xc1\xc1"), "sent an invalid message"),
    "one frame": (lies(b"D"), "received 1 frames"),
    "unknown kind": (lies(b"?", pack()), "message kind b'?' came"),
    "another step": (lies(step=77), "an answer to step 77"),
    "another seat": (
        lies(decisions=[[5, encode(ACTION), 0.1, False]]),
        "seat 5, which was not requested",
    ),
    "twice": (
        lies(decisions=[[0, encode(ACTION), 0.1, False]] * 2),
        "seat 0, which was not requested",
    ),
    "no answer": (lies(decisions=[]), "no answer for seats [0]"),
    "odd action": (lies(decisions=[[0, b"\xc1", 0.1, False]]), "not a valid message"),
    "odd time": (lies(decisions=[[0, encode(ACTION), float("nan")]]), "a decision"),
    "odd failure": (lies(decisions=[], failures=[[0, 1, False]]), "an error 1"),
    "arrays everywhere": (lies(decisions=[[np.zeros(3)] * 3]), "a decision"),
    "array as failure": (lies(decisions=[], failures=[[0, [np.zeros(2)] * 3, True]]), "an error"),
    "wrong shape": (lies(decisions=[[0, encode({"steer": [1, 2, 3]}), 0.1, False]]), ""),
    "not a number": (
        lies(decisions=[[0, encode({**ACTION, "steer": [float("nan")]}), 0.1, False]]),
        "",
    ),
    "silence": (lambda kind, _: [b"P", OPENED] if kind == b"O" else None, "in time"),
    "news of no seat": (lambda *_: [b"P", pack(seat=9, name="a")], "unexpected start of seat 9"),
    "bomb": (lies(b"D", bomb("rows of nothing", 6000)), "too much memory"),
    "bomb as action": (
        lies(decisions=[[0, bomb("rows of nothing", 6000), 0.1, False]]),
        "an empty array of a long shape",
    ),
    "wide texts as action": (
        lies(decisions=[[0, encode({**ACTION, "steer": ["x" * 30_000, *["x"] * 900]}), 0.1, True]]),
        "expected a number",
    ),
    "unknown keys": (
        lies(decisions=[[0, encode({"x" * 30_000: 1, "y" * 30_000: 2}), 0.1, False]]),
        "unknown keys xxxxx",
    ),
    "long error": (
        lies(decisions=[], failures=[[0, ["error", "y" * 1_000_000, "z" * 1_000_000], False]]),
        "yyyyy",
    ),
    "unknown fields": (lies(junk=[1] * 8000), "unknown fields ['junk'], expected some of"),
    "more frames": (lies(b"D", *[b""] * 50_000), "received 3 frames, expected 2"),
    "it sends the game's keys": (lies(b"E", pack(text="\x1b[2J" + "a" * 9000)), ": aaaa"),
}


@pytest.mark.parametrize("name", LIES)
def test_a_lying_server_affects_only_its_own_kart(name):
    lie, text = LIES[name]
    with (
        LyingServer(lie) as liar,
        server_process("heuristic") as (_, address),
        RemoteDriverGroup([liar.address, address], timeout=2.0) as group,
        measured() as cost,
    ):
        result = run_race(group.drivers, max_steps=12, **TRACK)
    rows = {row.agent: row for row in result.agents}
    assert text in rows["kart_0"].errors[0].message
    assert not rows["kart_1"].errors
    assert cost["memory"] < 200 << 20
    assert len(result.to_json()) < 50_000


NOTHING = [b"D", pack(step=0, decisions=[], failures=[])]
FLOODS = {
    "pings": ([b"L", b""], "ping 33 of 0 bytes since the last message to it, expected at most 32"),
    "a large ping": ([b"L", bytes(1 << 16)], "ping 1 of 65536 bytes"),
    "welcomes": ([b"W", pack(protocol=VERSION, agents=[["liar", "lies", []]])], "a second welcome"),
    "answers": (NOTHING, "an answer to step 0 that was not requested"),
}


@pytest.mark.parametrize("name", FLOODS)
def test_a_server_that_sends_more_messages_than_requested_affects_only_its_own_kart(name):
    """Otherwise the race could read them without end while it waits for the answer."""
    message, text = FLOODS[name]

    def flood_race(kind, asked):
        answer = lies()(kind, asked)
        return [*[message] * 50, answer] if kind == b"O" else answer

    with LyingServer(flood_race) as liar, RemoteDriverGroup([liar.address]) as group:
        result = run_race([*group.drivers, "heuristic"], max_steps=8, **TRACK)
    rows = {row.agent: row for row in result.agents}
    assert text in rows["kart_0"].errors[0].message
    assert not rows["kart_1"].errors


AGENT = """
import numpy
from stkzoo.drivers.process import Channel

send = Channel.send
Channel.send = lambda self, reply: send(self, reply | ({fields} if {when!r} in reply else {{}}))

def get_actor(module_dir, observation_space, action_space):
    return lambda state, observation: action_space.sample()
"""
BOMB = "{'steer': [(numpy.zeros(0, 'int8'),) * 8000] * 14}"


@pytest.mark.parametrize(
    ("when", "fields", "text"),
    [
        ("name", "{'paths_used': -1}", "expected its name and the number of track segments"),
        ("action", "{'action': {'steer': bytes(5 << 20)}}", "bytes, expected at most 65536"),
        ("action", f"{{'action': {BOMB}}}", "an empty array of a long shape"),
    ],
    ids=["segments", "large action", "memory bomb"],
)
def test_an_agent_cannot_make_the_other_agents_of_its_server_fail(tmp_path, when, fields, text):
    (tmp_path / "pystk_actor.py").write_text(AGENT.format(when=when, fields=fields))
    with (
        server_process(str(tmp_path), str(AGENTS / "plain")) as (_, address),
        RemoteDriverGroup([address]) as group,
    ):
        result = run_race(group.drivers, max_steps=8, **TRACK)
    rows = {row.agent: row for row in result.agents}
    assert text in rows["kart_0"].errors[0].message
    assert not rows["kart_1"].errors


def test_a_memory_bomb_in_an_open_message_costs_the_server_little():
    """A longer message may be cut off before it is read."""
    with server_process("heuristic", "--quiet") as (process, address):
        assert_serves(address)
        with measured(process.pid) as cost:
            for _ in range(20):
                with raw_client(address) as socket:
                    socket.send_multipart([b"O", bomb("rows of nothing", 1 << 15)])
                    kind, body = socket.recv_multipart()
                    assert kind == b"E"
                    assert "not a valid message" in unpack(body)["text"]
        assert_serves(address)
    assert cost["memory"] < 64 << 20
    assert cost["seconds"] < 5


@pytest.mark.parametrize("claimed", [0.0, 1e8])
def test_a_server_cannot_hide_or_invent_its_agents_times(claimed):
    def slowly(kind, asked):
        if kind == b"A":
            time.sleep(0.1)
        return lies(decisions=[[0, encode(ACTION), claimed, False]])(kind, asked)

    with LyingServer(slowly) as liar, RemoteDriverGroup([liar.address]) as group:
        result = run_race(group.drivers, max_steps=5, **TRACK)
    times = result.agents[0].action_time
    assert 0.1 <= times.mean <= times.max < 30


def test_a_reply_that_a_server_sends_before_the_observation_is_refused():
    """Otherwise the server's time for it would be 0."""

    class Ahead(LyingServer):
        def _serve(self):
            while not self._end.is_set():
                if not self._socket.poll(50):
                    continue
                identity, kind, *_ = self._socket.recv_multipart()
                if kind == b"H":
                    fields = {"protocol": VERSION, "agents": [["liar", "lies", []]]}
                    self._socket.send_multipart([identity, b"W", pack(**fields)])
                elif kind == b"O":
                    self._socket.send_multipart([identity, b"P", OPENED])
                elif kind == b"A":
                    for step in (1, 2):
                        frames = lies()(b"A", {"step": step})
                        self._socket.send_multipart([identity, *frames])

    with Ahead(None) as server, RemoteDriverGroup([server.address]) as group:

        class Waiting(RaceListener):
            def stepped(self, _):
                """Waits until the reply to the next step is there."""
                connection = group.connection(group.agents[0].server)
                assert wait_until(connection._has_mail)

        result = run_race([*group.drivers, "ai"], listeners=[Waiting()], max_steps=2, **TRACK)
    row = next(row for row in result.agents if row.agent == "kart_0")
    assert [error.step for error in row.errors] == [1]
    assert "an answer to step 2, expected 1" in row.errors[0].message


TOO_LONG = r"sent a message of more than 16 MiB, expected at most 4 MiB"
needs_byte_counts = pytest.mark.skipif(
    sys.platform != "linux", reason="only Linux reports how much a connection received"
)


@needs_byte_counts
def test_an_endless_message_from_a_server_is_cut_off():
    with (
        endless_server() as address,
        measured() as cost,
        pytest.raises(RemoteError, match=TOO_LONG),
    ):
        RemoteDriverGroup([address])
    assert cost["memory"] < 400 << 20


@needs_byte_counts
def test_an_endless_message_affects_only_its_servers_karts():
    """It arrives while the race waits for another agent to load."""
    loading = str(AGENTS / "hostile" / "sleeps.py")
    welcome = [b"W", pack(protocol=VERSION, agents=[["endless", "", []]])]
    with endless_server(welcome) as address:
        served = ServedAgent(Server(address), 0, "endless", "")
        with RemoteDriverGroup(agents=[served]) as group, measured() as cost:
            drivers = [loading, *group.drivers, "heuristic"]
            result = run_race(drivers, start_timeout=4.0, max_steps=5, **TRACK)
    rows = {row.driver: row for row in result.agents}
    assert re.search(TOO_LONG, rows["endless"].errors[0].message)
    assert not rows["heuristic"].errors
    assert cost["memory"] < 400 << 20


def test_a_slow_inline_driver_does_not_use_up_the_time_of_a_servers_agent():
    slow = find_driver(str(AGENTS / "hostile" / "slow.py"), inline=True)
    reply = lies(decisions=[[0, encode(ACTION), 0.0, False]])
    with LyingServer(reply) as server, RemoteDriverGroup([server.address]) as group:
        result = run_race([slow, *group.drivers], max_steps=5, **TRACK)
    assert result.agents[1].action_time.mean < 0.15


def test_a_server_can_shift_time_only_between_its_own_karts():
    """At least one of its karts pays for the whole time of each step."""
    claims = {0: 0.0, 1: 1e8}

    def shift(kind, asked):
        if kind == b"O":
            return [b"P", pack(seat=asked["seat"], name="liar", paths_used=None)]
        time.sleep(0.1)
        decisions = [
            [seat, encode(ACTION), claims[seat], False] for seat, _ in asked["observations"]
        ]
        return [b"D", pack(step=asked["step"], decisions=decisions, failures=[])]

    with LyingServer(shift) as liar, RemoteDriverGroup([liar.address]) as group:
        result = run_race(group.drivers * 2, max_steps=5, **TRACK)
    times = {row.agent: row.action_time for row in result.agents}
    assert times["kart_0"].total == 0
    assert times["kart_1"].mean >= 0.1


@pytest.mark.parametrize(
    "welcome",
    [
        b"\xc1",
        pack(protocol=99),
        pack(protocol=VERSION, agents=[]),
        pack(protocol=VERSION, agents=[[1, 2]]),
        pack(protocol=VERSION, agents=[["a", "b", ["x"]]]),
    ],
    ids=["garbage", "another protocol", "nobody", "no names", "unknown needs"],
)
def test_an_invalid_server_is_refused_before_the_race(welcome):
    class Odd(LyingServer):
        def _serve(self):
            identity, *_ = self._socket.recv_multipart()
            self._socket.send_multipart([identity, b"W", welcome])

    with Odd(None) as server, pytest.raises(RemoteError, match="sent an invalid message"):
        RemoteDriverGroup([server.address])
