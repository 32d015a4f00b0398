"""Runs races in several processes at a time."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Generator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from stkzoo._os import remove_stale_directories
from stkzoo.evaluation.batch.order import BatchOrder
from stkzoo.race.agents.failures import OutputTail

__all__ = ["OrderOutcome", "run_in_parallel"]

#: How often a race is tried whose process dies.
_TRIES = 2
_END_TIMEOUT = 5.0  # [s]
_LOOK_INTERVAL = 0.5  # [s]
_WORKER = "stkzoo.evaluation.batch.worker"


@dataclass(frozen=True, slots=True)
class OrderOutcome:
    """The outcome of one order.

    Attributes:
        order: the order.
        result: its result as JSON; empty if it could not be run.
        error: why it could not be run.
    """

    order: BatchOrder[Any]
    result: str = ""
    error: str = ""


def run_in_parallel(
    orders: Sequence[BatchOrder[Any]], jobs: int, race_timeout: float
) -> Generator[OrderOutcome, None, None]:
    """Runs races and yields each as soon as it is over; closing it ends those that run.

    Args:
        orders: the races.
        jobs: how many at a time.
        race_timeout: for one race [s]; its process is ended then.
    """
    waiting: queue.SimpleQueue[BatchOrder[Any]] = queue.SimpleQueue()
    for order in orders:
        waiting.put(order)
    outcomes: queue.SimpleQueue[OrderOutcome] = queue.SimpleQueue()
    lanes = [_Lane(waiting, outcomes, race_timeout) for _ in range(min(jobs, len(orders)))]
    try:
        for lane in lanes:
            lane.start()
        for _ in orders:
            yield _next(outcomes)
    finally:
        for lane in lanes:
            lane.close()
        remove_stale_directories()  # what races that were ended had in temporary folders


def _next(outcomes: queue.SimpleQueue[OrderOutcome]) -> OrderOutcome:
    while True:  # each race has an end; looking up now and then lets Ctrl-C through
        with contextlib.suppress(queue.Empty):
            return outcomes.get(timeout=_LOOK_INTERVAL)


class _Lane(threading.Thread):
    """Races one after another, in a process of its own that is replaced when it dies."""

    def __init__(
        self,
        waiting: queue.SimpleQueue[BatchOrder[Any]],
        outcomes: queue.SimpleQueue[OrderOutcome],
        race_timeout: float,
    ) -> None:
        super().__init__(daemon=True)
        self._race_timeout = race_timeout
        self._waiting, self._outcomes = waiting, outcomes
        self._worker: _Worker | None = None
        self._is_closed = self._was_late = False
        self._lock = threading.Lock()

    def run(self) -> None:
        """Runs what is waiting."""
        while not self._is_closed:
            try:
                order = self._waiting.get_nowait()
            except queue.Empty:
                break
            self._outcomes.put(self._outcome(order))
        self.close()

    def close(self) -> None:
        """Ends the process, also in the middle of a race."""
        with self._lock:
            self._is_closed = True
            worker, self._worker = self._worker, None
        if worker is not None:
            worker.close()

    def _outcome(self, order: BatchOrder[Any]) -> OrderOutcome:
        outcome = OrderOutcome(order)
        for _ in range(_TRIES):
            outcome = self._try(order)
            if outcome.result or self._is_closed or self._was_late:
                break
        return outcome

    def _try(self, order: BatchOrder[Any]) -> OrderOutcome:
        with self._lock:
            if self._is_closed:
                return OrderOutcome(order, error="the batch was ended")
            worker = self._worker = self._worker or _Worker()
        answer = worker.run(order, self._race_timeout)
        self._was_late = worker.was_late
        if not worker.is_alive:
            with self._lock:
                self._worker = None
            worker.close()
        return OrderOutcome(order, **answer)


class _Worker:
    """A process of :mod:`stkzoo.evaluation.batch.worker`."""

    def __init__(self) -> None:
        self.is_alive, self.was_late = True, False
        paths = [path for path in sys.path if path]
        self._process = subprocess.Popen(  # noqa: S603 - our own program
            [sys.executable, "-m", _WORKER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            # Modules that this program finds are found there too.
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            start_new_session=True,  # Ctrl-C is for this program, which ends its workers
        )
        self._said = OutputTail(self._process.stderr)

    def run(self, order: BatchOrder[Any], timeout: float) -> dict[str, str]:
        """Runs one race; the answer has ``result`` or ``error``."""
        kind, process = type(order), self._process
        line = {"module": kind.__module__, "class": kind.__name__, "order": asdict(order)}
        assert process.stdin is not None  # noqa: S101 - opened as pipes
        assert process.stdout is not None  # noqa: S101 - opened as pipes
        watch = threading.Timer(timeout, process.kill)
        watch.start()
        try:
            process.stdin.write(json.dumps(line).encode() + b"\n")
            process.stdin.flush()
            answer: dict[str, str] = json.loads(process.stdout.readline())
        except (OSError, ValueError):  # its output is closed, or cut off
            self.is_alive = False
            self.was_late = watch.finished.is_set()
            return {"error": self._why(timeout)}
        finally:
            watch.cancel()
        return answer

    def close(self) -> None:
        """Ends the process."""
        self.is_alive = False
        self._process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_TIMEOUT)
        self._said.close()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):  # what was not sent yet
                    stream.close()

    def _why(self, timeout: float) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_TIMEOUT)
        if self.was_late:
            return f"it was not over after {timeout:g} s"
        code, said = self._process.returncode, self._said.text()
        return f"its process ended with code {code}" + (f"; last lines:\n{said}" if said else "")
