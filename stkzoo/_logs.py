"""Logs of programs that strangers can reach: few lines, and no wait for their reader."""

from __future__ import annotations

import logging
import os
import queue
import time
from contextlib import suppress
from logging.handlers import QueueHandler, QueueListener

__all__ = ["BackgroundHandler", "RepeatFilter"]

#: Waiting lines; a line that finds the queue full is dropped.
_MAX_WAITING = 1000
#: Kinds of messages that a filter remembers.
_MAX_KINDS = 256


class RepeatFilter(logging.Filter):
    """Lets each kind of message through a few times in a period, and counts the others.

    Messages are of one kind if their logger, level and text before formatting are the same. The
    next message of the kind that comes through says how many were left out.

    Args:
        most: messages of one kind in a period.
        period: its length [s].
    """

    def __init__(self, most: int = 5, period: float = 10.0) -> None:
        super().__init__()
        self._most, self._period = most, period
        self._kinds: dict[tuple[str, int, str], tuple[float, int]] = {}  # period's end, messages

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to log this record."""
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
    """Writes log records to a descriptor in a thread of its own.

    A program that writes its log itself stops when the log is a pipe that nobody reads. This
    handler keeps a bounded number of lines instead, drops those that find no room, and logs how
    many were dropped as soon as there is room again.

    Args:
        descriptor: where to write; 2 is stderr.
        most: lines that wait at most.
    """

    def __init__(self, descriptor: int = 2, most: int = _MAX_WAITING) -> None:
        self._waiting: queue.Queue[logging.LogRecord] = queue.Queue(most)
        super().__init__(self._waiting)
        self._num_dropped = 0
        self._listener = _DescriptorWriter(self._waiting, descriptor)
        self._listener.start()  # a daemon thread

    def enqueue(self, record: logging.LogRecord) -> None:
        """Queues a record, or counts it as dropped."""
        try:
            if self._num_dropped:
                self._waiting.put_nowait(_notice(self._num_dropped))
                self._num_dropped = 0
            self._waiting.put_nowait(record)
        except queue.Full:
            self._num_dropped += 1

    def drain(self, seconds: float = 1.0) -> None:
        """Waits until all lines are written, at most so long."""
        deadline = time.monotonic() + seconds
        while self._waiting.unfinished_tasks and time.monotonic() < deadline:
            time.sleep(0.005)

    def close(self) -> None:
        """Ends the thread once it has written the waiting lines; does not wait for it."""
        with suppress(queue.Full):
            self._listener.enqueue_sentinel()
        super().close()


def _notice(count: int) -> logging.LogRecord:
    text = f"{count} lines were dropped, because the reader of this log was too slow"
    return logging.makeLogRecord({"msg": text, "levelno": logging.WARNING})


class _DescriptorWriter(QueueListener):
    """Writes to a descriptor without Python's buffers: their locks would block the exit."""

    def __init__(self, waiting: queue.Queue[logging.LogRecord], descriptor: int) -> None:
        super().__init__(waiting)
        self._descriptor = descriptor

    def handle(self, record: logging.LogRecord) -> None:
        """Writes a record; it is lost if the descriptor was closed."""
        data = f"{record.getMessage()}\n".encode("utf-8", "backslashreplace")
        try:
            while data:
                data = data[os.write(self._descriptor, data) :]
        except OSError:
            return
