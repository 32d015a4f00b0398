"""Decision times of agents, measured with the race's own clock."""

import math
import socket
import threading
import time

import pytest

from stkzoo.drivers.driver import find_driver
from stkzoo.drivers.messages import Ready, encode
from stkzoo.drivers.replies import LENGTH, ReplyChannel
from stkzoo.errors import ProtocolError
from stkzoo.race import run_race
from tests.support.paths import AGENTS

PLAIN = str(AGENTS / "plain")


def hostile(name):
    return str(AGENTS / "hostile" / f"{name}.py")


def race(*drivers, **settings):
    return run_race(list(drivers), track="lighthouse", seed=1, **{"max_steps": 5, **settings})


def times(result):
    return {row.driver: row.action_time for row in result.agents}


@pytest.mark.slow
def test_a_slow_agent_does_not_use_up_another_agents_time():
    """The race waits for the slow agent first."""
    found = times(race(hostile("slow"), PLAIN, hostile("trickles"), max_steps=6))
    assert found["Plain"].mean < 0.15
    assert min(found["slow"].mean, found["trickles"].mean) > 0.25


@pytest.mark.slow
def test_a_slow_inline_driver_does_not_use_up_another_agents_time():
    """The race computes its action first."""
    found = times(race(find_driver(hostile("slow"), inline=True), PLAIN))
    assert found["Plain"].mean < 0.15


@pytest.fixture
def channel():
    """Yields a channel and the other end of its socket."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        channel = ReplyChannel(ours)
        yield channel, theirs
        channel.close()


REPLY = Ready("seven", 7)
DATA = encode(REPLY)
FRAME = LENGTH.pack(len(DATA)) + DATA


def test_an_agent_does_not_pay_for_the_time_in_which_the_race_is_busy(channel):
    """Such as the time to decode another agent's reply, or to end another agent."""
    ours, theirs = channel
    ours.send(b"now")
    theirs.sendall(FRAME)
    time.sleep(0.5)
    assert ours.receive() == REPLY
    assert ours.seconds < 0.4


def test_an_agent_pays_for_the_time_in_which_the_race_waits_for_it(channel):
    ours, theirs = channel
    ours.send(b"now")
    replier = threading.Timer(0.2, theirs.sendall, (FRAME,))
    replier.start()
    assert ours.receive() == REPLY
    assert ours.seconds > 0.15
    replier.join()


def test_a_long_reply_is_refused_before_it_is_received(channel):
    ours, theirs = channel
    ours.send(b"now")
    theirs.sendall(LENGTH.pack((64 << 10) + 1))
    with pytest.raises(ProtocolError, match="of 65537 bytes came, expected at most 65536"):
        ours.receive()


def test_a_reply_sent_before_its_request_is_refused(channel):
    ours, theirs = channel
    theirs.sendall(FRAME)
    with pytest.raises(ProtocolError, match="a reply came before its request; expected"):
        ours.send(b"now")


@pytest.mark.slow
def test_an_agent_that_answers_one_step_ahead_is_retired():
    result = race(hostile("ahead"), "ai")
    row = next(row for row in result.agents if row.driver == "ahead")
    assert row.status == "retired"
    assert row.errors[0].step == 1
    assert "came before its request" in row.errors[0].message


@pytest.mark.slow
def test_an_agent_can_think_between_its_decisions():
    """Its thread works while the race waits for the slow agent."""
    result = race(hostile("slow"), hostile("ponders"))
    assert not result.has_errors
    assert times(result)["ponders"].mean < 0.15


def test_a_reply_in_single_bytes_does_not_extend_its_deadline(channel):
    ours, theirs = channel
    ours.send(b"now")
    ours.deadline = time.monotonic() + 0.3

    over = threading.Event()

    def trickle():
        theirs.sendall(b"\0\0\0\xff")
        while not over.wait(0.02):
            theirs.sendall(b"\1")

    sender = threading.Thread(target=trickle)
    sender.start()
    begin = time.monotonic()
    with pytest.raises(TimeoutError):
        ours.receive()
    assert time.monotonic() - begin < 1.5
    over.set()
    sender.join()


def test_a_process_that_does_not_read_cannot_delay_its_race_past_the_deadline(channel):
    ours, _ = channel
    ours.deadline = time.monotonic() + 0.2
    with pytest.raises(TimeoutError):
        ours.send(b"x" * (4 << 20))


def test_time_is_finite_without_a_reply(channel):
    ours, _ = channel
    ours.send(b"now")
    assert math.isfinite(ours.seconds)
