"""Messages between a program and its engine processes."""

import os
import signal
import threading

import pytest

from stkzoo.engine import wire


@pytest.fixture
def ends():
    ours, theirs = wire.pair()
    ours.settimeout(5.0)
    with ours, theirs:
        yield ours, theirs


def after(seconds, deed, *arguments):
    timer = threading.Timer(seconds, deed, arguments)
    timer.start()
    return timer


@pytest.mark.parametrize("delay", [0.0, 0.01, 0.1])
def test_a_message_is_received_whole(ends, delay):
    ours, theirs = ends
    frames = [b"", b"a", bytes(range(256)) * 8000]  # larger than the buffers of a connection
    sending = after(delay, wire.send, theirs, wire.OK, *frames)
    assert wire.receive(ours) == (wire.OK, frames)
    sending.join()


def test_a_closed_connection_is_detected(ends):
    ours, theirs = ends
    closing = after(0.02, theirs.close)
    with pytest.raises(EOFError):
        wire.receive(ours)
    closing.join()


def test_waiting_ends_at_the_timeout(ends):
    ours, _ = ends
    ours.settimeout(0.1)
    with pytest.raises(TimeoutError):
        wire.receive(ours)


def test_an_interrupt_ends_waiting(ends):
    ours, _ = ends
    pressing = after(0.1, os.kill, os.getpid(), signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        wire.receive(ours)
    pressing.join()


@pytest.mark.parametrize(
    "data",
    [b"O", b"O\x01", b"O\x01\xff\xff\xff\xff", b"O\x01\x01\x00\x00\x00ab"],
    ids=["no number", "no length", "too long", "too much"],
)
def test_a_broken_message_ends_the_connection(ends, data):
    ours, theirs = ends
    theirs.send(data)
    theirs.close()
    with pytest.raises(EOFError):
        wire.receive(ours)
