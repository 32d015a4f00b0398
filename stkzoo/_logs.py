"""Logs of public servers, which clients cannot flood."""

from __future__ import annotations

import logging
import time

#: Maximum number of kinds of messages that a filter remembers.
_MAX_KINDS = 256


class RepeatFilter(logging.Filter):
    """A log filter that limits how often each kind of message is logged in a period.

    Messages are of the same kind if their logger, level and text before formatting are equal. The
    first message in a later period reports how many messages of its kind were left out.

    Args:
        most: maximum number of messages of one kind in a period.
        period: length of a period [s].
    """

    def __init__(self, most: int = 5, period: float = 10.0) -> None:
        super().__init__()
        self._most, self._period = most, period
        self._kinds: dict[tuple[str, int, str], tuple[float, int]] = {}  # end of period, count

    def filter(self, record: logging.LogRecord) -> bool:
        """Returns whether to log a record."""
        message, now = (record.name, record.levelno, str(record.msg)[:500]), time.monotonic()
        end, count = self._kinds.get(message, (0.0, 0))
        if now >= end:
            if len(self._kinds) >= _MAX_KINDS:
                self._kinds.clear()
            self._kinds[message] = (now + self._period, 1)
            if count > self._most:
                record.msg = f"{record.getMessage()} ({count - self._most} more were left out)"
                record.args = None
            return True
        self._kinds[message] = (end, count + 1)
        return count < self._most
