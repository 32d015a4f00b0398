"""Logs cannot be flooded."""

import logging
from logging.handlers import BufferingHandler

import pytest

from stkzoo._logs import RepeatFilter


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
