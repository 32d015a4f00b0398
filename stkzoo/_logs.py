"""Logs of public servers: clients cannot flood the log, and a slow reader cannot block them."""

from __future__ import annotations

import logging
import os
import queue
import time
from contextlib import suppress
from logging.handlers import QueueHandler, QueueListener

__all__ = ["BackgroundHandler", "RepeatFilter"]

#: Maximum number of waiting lines. Further lines are dropped.
_MAX_WAITING = 1000
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
        kind, now = (record.name, record.levelno, str(record.msg)[:500]), time.monotonic()
        end, count = self._kinds.get(kind, (0.0, 0))
        if now >= end:
            if len(self._kinds) >= _MAX_KINDS:
                self._kinds.clear()
            self._kinds[kind] = (now + self._period, 1)
            if count > self._most:
                record.msg = f"{record.getMessage()} ({count - self._most} more were left out)"
                record.args = None
            return True
        self._kinds[kind] = (end, count + 1)
        return count < self._most


class BackgroundHandler(QueueHandler):
    """A log handler that writes records to a descriptor in a separate thread.

    A program that writes its log directly blocks if the log is a pipe whose reader has stopped.
    This handler has a queue of limited length instead. It drops lines while the queue is full, and
    later logs how many it dropped.

    Args:
        descriptor: the descriptor; 2 is stderr.
        most: maximum number of lines in the queue.
    """

    def __init__(self, descriptor: int = 2, most: int = _MAX_WAITING) -> None:
        self._waiting: queue.Queue[logging.LogRecord] = queue.Queue(most)
        super().__init__(self._waiting)
        self._num_dropped = 0
        self._listener = _DescriptorWriter(self._waiting, descriptor)
        self._listener.start()  # starts a daemon thread

    def enqueue(self, record: logging.LogRecord) -> None:
        """Queues a record, or counts it as dropped."""
        try:
            if self._num_dropped:
                self._waiting.put_nowait(_notice(self._num_dropped))
                self._num_dropped = 0
            self._waiting.put_nowait(record)
        except queue.Full:
            self._num_dropped += 1

    def drain(self) -> None:
        """Waits until all lines are written, but at most one second."""
        deadline = time.monotonic() + 1.0
        while self._waiting.unfinished_tasks and time.monotonic() < deadline:
            time.sleep(0.005)

    def close(self) -> None:
        """Ends the thread after it has written the waiting lines, without waiting for this."""
        with suppress(queue.Full):
            self._listener.enqueue_sentinel()
        super().close()


def _notice(count: int) -> logging.LogRecord:
    text = f"{count} lines were dropped, because the reader of this log was too slow"
    return logging.makeLogRecord({"msg": text, "levelno": logging.WARNING})


class _DescriptorWriter(QueueListener):
    """Writes records to a descriptor without Python's buffers, whose locks could block the exit."""

    def __init__(self, waiting: queue.Queue[logging.LogRecord], descriptor: int) -> None:
        super().__init__(waiting)
        self._descriptor = descriptor

    def handle(self, record: logging.LogRecord) -> None:
        """Writes a record. If the descriptor is closed, the record is lost."""
        data = f"{record.getMessage()}\n".encode("utf-8", "backslashreplace")
        try:
            while data:
                data = data[os.write(self._descriptor, data) :]
        except OSError:
            return
