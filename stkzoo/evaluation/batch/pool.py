"""Runs races in several processes at a time."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass
from typing import Any

from stkzoo._os import remove_stale_directories
from stkzoo.evaluation.batch.order import BatchOrder
from stkzoo.race.agents.failures import OutputTail

#: How often a race is tried whose process dies.
_TRIES = 2
_END_TIMEOUT = 5.0  # [s]
_WAIT_INTERVAL = 0.5  # [s]
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
        jobs: races at a time.
        race_timeout: for one race [s]; its process is ended then.
    """
    workers = _Workers(race_timeout)
    threads = ThreadPoolExecutor(jobs)
    try:
        waiting = {threads.submit(workers.run, order) for order in orders}
        while waiting:  # the timeout lets Ctrl-C through
            done, waiting = wait(waiting, _WAIT_INTERVAL, FIRST_COMPLETED)
            for future in done:
                yield future.result()
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        workers.close()
        threads.shutdown()
        remove_stale_directories()  # of races that were ended


class _Workers:
    """The worker processes, at most one for each thread that calls :meth:`run`."""

    def __init__(self, race_timeout: float) -> None:
        self._race_timeout = race_timeout
        self._lock = threading.Lock()
        self._idle: list[_Worker] = []
        self._busy: set[_Worker] = set()
        self._is_closed = False

    def run(self, order: BatchOrder[Any]) -> OrderOutcome:
        """Runs a race, again if its process dies."""
        outcome = OrderOutcome(order, error="the batch was ended")
        for _ in range(_TRIES):
            with self._lock:
                if self._is_closed:
                    break
                worker = self._idle.pop() if self._idle else _Worker()
                self._busy.add(worker)
            outcome = OrderOutcome(order, **worker.run(order, self._race_timeout))
            with self._lock:
                self._busy.discard(worker)
                if worker.is_alive and not self._is_closed:
                    self._idle.append(worker)
            if not worker.is_alive:
                worker.close()
            if outcome.result or worker.was_late:
                break
        return outcome

    def close(self) -> None:
        """Ends all processes, also during a race."""
        with self._lock:
            self._is_closed = True
            workers = [*self._idle, *self._busy]
        for worker in workers:
            worker.close()


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
