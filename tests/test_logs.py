"""Logs cannot be flooded, and an unread log cannot block the program."""

import logging
import os
from logging.handlers import BufferingHandler

import pytest

from stkzoo._logs import BackgroundHandler, RepeatFilter
from tests.support.processes import run_program, wait_until


@pytest.fixture
def log():
    log = logging.getLogger("tests.logs")
    log.propagate = False
    yield log
    for handler in log.handlers:
        handler.close()
    log.handlers, log.filters = [], []


@pytest.fixture
def lines(log):
    """Returns a list that receives the records of a log."""
    handler = BufferingHandler(10_000)
    log.addHandler(handler)
    return handler.buffer


@pytest.fixture
def pipe():
    ends = os.pipe()
    yield ends
    for end in ends:
        os.close(end)


def test_a_repeated_message_is_logged_a_few_times(log, lines):
    log.addFilter(RepeatFilter(most=2))
    for number in range(100):
        log.warning("number %d", number)
    log.warning("another")
    assert [line.getMessage() for line in lines] == ["number 0", "number 1", "another"]


def test_a_later_message_says_how_many_were_left_out(log, lines, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("stkzoo._logs.time.monotonic", lambda: now[0])
    log.addFilter(RepeatFilter(most=1, period=10.0))
    for _ in range(5):
        log.warning("again")
    now[0] += 11
    log.warning("again")
    assert [line.getMessage() for line in lines] == ["again", "again (4 more were left out)"]


def test_a_filter_remembers_a_limited_number_of_messages(log):
    own = RepeatFilter()
    log.addFilter(own)
    for number in range(5000):
        log.warning(f"number {number}")
    assert len(own._kinds) <= 256


def test_lines_are_written_in_order(log, pipe):
    source, sink = pipe
    handler = BackgroundHandler(sink)
    log.addHandler(handler)
    for number in range(50):
        log.warning("line %d", number)
    handler.drain()
    assert os.read(source, 1 << 16).decode().split("\n")[:-1] == [f"line {n}" for n in range(50)]


def test_an_unread_log_drops_lines_and_says_how_many(log, pipe):
    source, sink = pipe
    handler = BackgroundHandler(sink, most=10)
    log.addHandler(handler)
    text = "x" * 1000
    for _ in range(500):
        log.warning(text)
    seen = b""

    def is_drained():
        nonlocal seen
        log.warning("end")
        seen += os.read(source, 1 << 20)
        return b"end\n" in seen and b"lines were dropped" in seen

    assert wait_until(is_drained)
    assert seen.count(b"\n") < 250


def test_a_program_with_an_unread_log_ends():
    program = run_program("""
        import logging, os
        from stkzoo._logs import BackgroundHandler
        _, sink = os.pipe()
        handler = BackgroundHandler(sink)
        logging.basicConfig(handlers=[handler])
        for _ in range(5000):
            logging.warning("x" * 500)
        print("done")
    """)
    assert (program.stdout, program.returncode) == ("done\n", 0)


def test_a_log_with_a_closed_descriptor_is_lost(log):
    source, sink = os.pipe()
    os.close(source)
    handler = BackgroundHandler(sink)
    log.addHandler(handler)
    log.warning("a")
    handler.drain()
    os.close(sink)
