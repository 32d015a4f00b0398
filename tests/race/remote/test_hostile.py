"""Clients and servers that do not keep to the protocol."""

import os
import random
import threading
import time

import msgspec
import pytest
import zmq

from stkzoo.drivers.messages import Decided, Ready, encode
from stkzoo.errors import RemoteError
from stkzoo.race import RaceListener, find_driver, run_race
from stkzoo.race.remote import RemoteDriverGroup
from stkzoo.race.remote.protocol import (
    VERSION,
    Act,
    Bye,
    Hello,
    Open,
    Refused,
    Welcome,
    read_reply,
)
from stkzoo.race.remote.protocol import Offer as AgentOffer
from tests.support.paths import AGENTS
from tests.support.processes import measured, resident_memory, wait_until
from tests.support.remote_race import (
    LyingServer,
    open_request,
    raw_client,
    server_process,
    server_thread,
    write_agent,
)

pytestmark = pytest.mark.slow

TRACK = {"track": "lighthouse", "seed": 3}


def pack(**fields):
    return msgspec.msgpack.encode(fields)


def assert_serves(address):
    with RemoteDriverGroup([address]) as group:
        result = run_race([*group.drivers, "ai"], max_steps=10, **TRACK)
    assert not any(row.errors for row in result.agents)


def bad_messages(chance):
    """Yields messages to a server without end; most of them are invalid, some only unusual."""
    odd = (None, True, -1, 2**63, 1.5, float("nan"), "", "x" * 300, b"\xff", [], {}, [[0]] * 99)
    good = (open_request(), encode(Act(b"\x80")), encode(Bye()), encode(Hello(4, "")))
    fields = list(msgspec.msgpack.decode(open_request()))
    while True:
        data = bytearray(chance.choice(good))
        match chance.randrange(5):
            case 0:
                yield [chance.randbytes(chance.randrange(100))]
            case 1:
                yield [bytes(data[: chance.randrange(len(data))])]
            case 2:
                for _ in range(chance.randrange(1, 8)):
                    data[chance.randrange(len(data))] = chance.randrange(256)
                yield [bytes(data)]
            case 3:
                yield [open_request(**{chance.choice(fields): chance.choice(odd)})]
            case 4:
                yield [chance.randbytes(chance.randrange(5)) for _ in range(chance.randrange(1, 6))]


def send_bad_messages(address, messages, count):
    """Sends messages, and waits after each ten until the server has read them."""
    with raw_client(address) as client:
        for number in range(count):
            client.send_multipart(next(messages))
            if number % 10 == 9:
                client.send(encode(Hello(VERSION, "")))
                while not isinstance(read_reply(client.recv_multipart()), Welcome):
                    pass


def test_a_server_survives_thousands_of_invalid_messages():
    with server_process("heuristic", "--quiet") as (process, address):
        assert_serves(address)
        messages = bad_messages(random.Random(1))
        send_bad_messages(address, messages, 500)
        before = resident_memory(process.pid)
        for _ in range(5):
            send_bad_messages(address, messages, 500)
        assert_serves(address)
        assert resident_memory(process.pid) - before < 64 << 20


def test_a_client_that_reads_nothing_does_not_make_the_server_queue_replies():
    with server_process("heuristic", "--quiet") as (process, address):
        assert_serves(address)
        before = resident_memory(process.pid)
        with raw_client(address) as client:
            for _ in range(100_000):
                client.send(encode(Hello(VERSION, "")))
            assert_serves(address)
            assert resident_memory(process.pid) - before < 32 << 20


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
            socket.send(os.urandom(5 << 20))
            assert not socket.poll(300)
        assert_serves(server.address)


@pytest.mark.parametrize(
    ("frames", "text"),
    [
        ([encode(Bye()), b"a", b"b"], "a message of several frames came"),
        ([pack(type="hello", protocol=3, stkzoo="")], f"speaks protocol 3, this one {VERSION}"),
        ([encode(Act(b""))], "a request came before the reply to the last one, or no agent"),
        ([pack(type="what")], "Invalid value 'what'"),
        ([open_request(driver=True)], r"Expected `int`, got `bool` - at `$.driver`"),
        ([open_request(driver=1)], "driver 1, expected 0 to 0"),
        ([open_request(), open_request()], "several frames"),
        ([open_request(extras=["x"])], "ground|motion"),
        ([open_request(start_timeout=-1)], "Expected `float` > 0"),
        ([b"\x82\xa4type\xa4open\xa6driver" + b"\x91" * 60_000], "not a valid message"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_an_invalid_message_gets_an_answer_that_explains_the_error(frames, text):
    with server_thread([find_driver("heuristic")]) as server:
        with raw_client(server.address) as socket:
            socket.send_multipart(frames)
            refused = read_reply(socket.recv_multipart())
        assert isinstance(refused, Refused)
        assert text in refused.reason
        with RemoteDriverGroup([server.address]) as group:
            assert len(group.drivers) == 1


def test_a_client_cannot_access_the_agents_of_another_client():
    with (
        server_thread([find_driver("heuristic")]) as server,
        RemoteDriverGroup([server.address]) as group,
        raw_client(server.address) as socket,
    ):
        done = threading.Event()

        def disturb():
            while not done.wait(0.005):
                for message in (Act(b"\x80"), Bye()):
                    socket.send(encode(message))
                while socket.poll(0):
                    socket.recv_multipart()

        thread = threading.Thread(target=disturb)
        thread.start()
        result = run_race([*group.drivers, "ai"], max_steps=30, **TRACK)
        done.set()
        thread.join()
    assert not any(row.errors for row in result.agents)


def decided(steer=0.0):
    return pack(type="decided", action=[0, steer, *[0] * 5], is_clipped=False)


def lies(*data):
    """Returns a function that provides an agent, then replies with messages."""

    def lie(message):
        ready = [encode(Ready("liar", None))]
        return ready if isinstance(message, Open) else data or [decided()]

    return lie


def failed(text):
    return pack(type="failed", kind="error", text=text, trace="", is_usable=True)


LIES = {
    "garbage": (lies(b"\xc1\xc1"), "sent an invalid message"),
    "twice": (lies(decided(), decided()), "a message 'decided' that was not requested"),
    "another reply": (lies(encode(Ready("liar", None))), "a message 'ready' that was not"),
    "an action out of bounds": (lies(decided(steer=7.0)), "Expected `float` <= 1.0"),
    "silence": (lambda message: lies()(message) if isinstance(message, Open) else [], "in time"),
    "a bomb": (lies(b"\x81\xa4type" + b"\x91" * 1_000_000), "not a valid message"),
    "a long error": (lies(failed("y" * 1_000_000)), "length <= 8000"),
    "an error of its agent": (lies(failed("no fuel")), ": no fuel"),
    "too many paths": (
        lambda _: [pack(type="ready", name="", paths_used=2**61)],
        "Expected `int` <= 8192",
    ),
    "it sends the game's keys": (lies(encode(Refused("\x1b[2J" + "a" * 7000))), ": aaaa"),
}


@pytest.mark.parametrize("name", LIES)
def test_a_lying_server_affects_only_its_own_kart(name):
    lie, text = LIES[name]
    with (
        LyingServer(lie) as liar,
        RemoteDriverGroup([liar.address], timeout=2.0) as group,
        measured() as cost,
    ):
        result = run_race([*group.drivers, "heuristic"], max_steps=6, **TRACK)
    rows = {row.agent: row for row in result.agents}
    message = rows["kart_0"].errors[0].message
    assert text in message
    assert message.startswith(liar.address) or f" {liar.address} " in message
    assert not rows["kart_1"].errors
    assert cost["memory"] < 200 << 20
    assert len(result.to_json()) < 50_000


FLOODS = {
    "welcomes": Welcome(VERSION, "", [AgentOffer("liar", "lies", [])]),
    "answers": Decided([0.0] * 7, is_clipped=False),
}


@pytest.mark.parametrize("name", FLOODS)
def test_a_server_that_sends_more_messages_than_requested_affects_only_its_own_kart(name):
    """Otherwise the race could read them without end while it waits for the answer."""
    message = FLOODS[name]

    def flood(asked):
        return [*[encode(message)] * 220, *lies()(asked)]

    with LyingServer(flood) as liar, RemoteDriverGroup([liar.address]) as group:
        result = run_race([*group.drivers, "heuristic"], max_steps=4, **TRACK)
    rows = {row.agent: row for row in result.agents}
    assert "that was not requested" in rows["kart_0"].errors[0].message
    assert not rows["kart_1"].errors


AGENT = """
from stkzoo.drivers.messages import Decided, Failed, Ready
from stkzoo.drivers.isolated import Channel

send = Channel.send
Channel.send = lambda self, reply: send(self, {lie} if isinstance(reply, {when}) else reply)

def get_actor(module_dir, observation_space, action_space):
    return lambda state, observation: action_space.sample()
"""


@pytest.mark.parametrize(
    ("when", "lie", "text"),
    [
        ("Ready", 'Ready("", -1)', "Expected `int` >= 0"),
        ("Decided", 'Failed("error", "x" * (5 << 16), "", True)', "expected at most 65536"),
        ("Decided", 'Failed("error", "x" * 9000, "", True)', "length <= 8000"),
    ],
    ids=["segments", "a large reply", "a long text"],
)
def test_an_agent_cannot_make_the_other_agents_of_its_server_fail(tmp_path, when, lie, text):
    (tmp_path / "pystk_actor.py").write_text(AGENT.format(when=when, lie=lie))
    with (
        server_process(str(tmp_path), str(AGENTS / "plain")) as (_, address),
        RemoteDriverGroup([address]) as group,
    ):
        result = run_race(group.drivers, max_steps=8, **TRACK)
    rows = {row.agent: row for row in result.agents}
    assert text in rows["kart_0"].errors[0].message
    assert not rows["kart_1"].errors


def test_a_server_cannot_hide_the_time_of_its_agents():
    def slowly(message):
        if isinstance(message, Act):
            time.sleep(0.1)
        return lies()(message)

    with LyingServer(slowly) as liar, RemoteDriverGroup([liar.address]) as group:
        result = run_race(group.drivers, max_steps=5, **TRACK)
    times = result.agents[0].action_time
    assert 0.1 <= times.mean <= times.max < 30


def test_a_reply_that_a_server_sends_before_the_observation_is_refused():
    """Otherwise the server's time for it would be 0."""

    with LyingServer(lies(decided(), decided())) as server:
        group = RemoteDriverGroup([server.address])
        connect, connections = group.connect, []
        group.connect = lambda server: connections.append(connect(server)) or connections[-1]

        class Waiting(RaceListener):
            def stepped(self, _):
                """Waits until the reply to the next step is there."""
                socket = connections[0]._socket
                assert wait_until(lambda: socket.closed or socket.EVENTS & zmq.POLLIN)

        with group:
            result = run_race([*group.drivers, "ai"], listeners=[Waiting()], max_steps=2, **TRACK)
    row = next(row for row in result.agents if row.agent == "kart_0")
    assert [error.step for error in row.errors] == [1]
    assert "a message 'decided' that was not requested" in row.errors[0].message


def test_a_slow_inline_driver_does_not_use_up_the_time_of_a_servers_agent():
    slow = find_driver(str(AGENTS / "hostile" / "slow.py"), inline=True)
    with LyingServer(lies()) as server, RemoteDriverGroup([server.address]) as group:
        result = run_race([slow, *group.drivers], max_steps=5, **TRACK)
    assert result.agents[1].action_time.mean < 0.15


@pytest.mark.parametrize(
    ("welcome", "text"),
    [
        (b"\xc1", "not a valid message"),
        (encode(Welcome(99, "", [AgentOffer("a", "b", [])])), "speaks protocol 99"),
        (encode(Welcome(VERSION, "", [])), "Expected `array` of length >= 1"),
        (encode(Welcome(VERSION, "", [AgentOffer("a", "b", ["x"])])), "matching regex"),
    ],
    ids=["garbage", "another protocol", "nobody", "unknown needs"],
)
def test_an_invalid_server_is_refused_before_the_race(welcome, text):
    with (
        LyingServer(lies(), welcome) as odd,
        pytest.raises(RemoteError, match=f"sent an invalid message: .*{text}"),
    ):
        RemoteDriverGroup([odd.address])
