"""A pool of worker processes that run races: its client and the program of a worker."""

from __future__ import annotations

import contextlib
import itertools
import json
import logging
import os
import subprocess
import sys
import threading
import traceback
from collections.abc import Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass, replace
from importlib import import_module
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import msgspec

from stkzoo._python import python_command, search_path
from stkzoo._temporary import remove_stale_folders
from stkzoo.drivers.failures import OutputTail
from stkzoo.drivers.sandbox import SHARED_CORES
from stkzoo.errors import StkzooError
from stkzoo.evaluation.batch.order import RaceOrder

#: Maximum number of trial races without some agents, to find agents that end the process of a race.
_MAX_TRIALS = 32
_END_TIMEOUT = 5.0  # [s]
_WAIT_INTERVAL = 0.5  # [s]
logger = logging.getLogger(__name__)
_WORKER = "from stkzoo.evaluation.batch.pool import serve; serve()"


@dataclass(frozen=True, slots=True)
class OrderOutcome:
    """The outcome of one order.

    Attributes:
        order: the order.
        result: result of the race as JSON; empty if the race could not be run.
        error: why the race could not be run; empty if it was run.
    """

    order: RaceOrder
    result: str = ""
    error: str = ""


def run_in_parallel(
    orders: Sequence[RaceOrder], folder: Path, jobs: int, race_timeout: float
) -> Generator[OrderOutcome, None, None]:
    """Runs races in parallel and yields each outcome as soon as its race ends.

    Closing the generator ends the running races.

    Args:
        orders: the races.
        folder: folder of the batch.
        jobs: maximum number of races at the same time.
        race_timeout: time limit of a race [s], after which its process is killed.
    """
    count = min(jobs, len(orders))
    workers = [_Worker(folder, race_timeout, is_alone=count == 1) for _ in range(count)]
    idle: SimpleQueue[_Worker] = SimpleQueue()
    for worker in workers:
        idle.put(worker)

    def run(order: RaceOrder) -> OrderOutcome:
        own = idle.get()  # does not wait, because each running thread has a worker
        try:
            return own.run(order)
        finally:
            idle.put(own)

    threads = ThreadPoolExecutor(jobs)
    try:
        waiting = {threads.submit(run, order) for order in orders}
        while waiting:  # the timeout lets Ctrl-C interrupt the wait
            done, waiting = wait(waiting, _WAIT_INTERVAL, FIRST_COMPLETED)
            for future in done:
                yield future.result()
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        for worker in workers:
            worker.close()
        threads.shutdown()
        remove_stale_folders()  # killed races leave directories


class _Worker:
    """Runs races one after another in a worker process, and starts another if the process ends."""

    def __init__(self, folder: Path, race_timeout: float, *, is_alone: bool) -> None:
        self._is_alone = is_alone
        self._folder, self._timeout = str(folder.absolute()), race_timeout
        self._lock = threading.Lock()
        self._running: tuple[subprocess.Popen[bytes], OutputTail] | None = None
        self._is_closed = self._was_late = False

    def run(self, order: RaceOrder) -> OrderOutcome:
        """Runs a race. If its process ends, repeats the race to find the agents that ended it.

        The first repetition isolates each agent as far as possible. After a timeout, it also has a
        time budget, and counts if it ends in time. If some agents may have ended the process, the
        race is then repeated without some of them. Agents whose absence lets the race finish count
        as failed. Without this rule, an agent could void a race that it is about to lose. If the
        race finishes with isolated agents, and also in the absence of any one of several agents, an
        agent may have tried to put the blame on another. In this case, the race with isolated
        agents counts.
        """
        outcome, is_over = self._run_once(order)
        if is_over or self._is_closed:  # close() ended the process, not an agent
            return outcome
        suspects, was_late = order.suspects(), self._was_late
        self._report(order, outcome, suspects)
        isolated = order.hurried(self._timeout) if was_late else order.isolated()
        again, is_over = self._run_once(isolated)
        if is_over and (was_late or isolated == order or not suspects):
            return replace(again, order=order)
        chosen = isolated if is_over else None
        sizes = range(1, 2) if was_late else range(len(suspects) + 1)
        absent = self._culprits(order, suspects, sizes, is_unique=chosen is not None)
        if absent is not None:
            chosen = replace(order, absent=absent)
        if chosen is None:
            return outcome
        final, is_over = self._run_once(chosen)  # the last run must write the race's other files
        return replace(final, order=order) if is_over else outcome

    def _culprits(
        self, order: RaceOrder, suspects: tuple[int, ...], sizes: range, *, is_unique: bool
    ) -> tuple[int, ...] | None:
        """Returns the smallest group of agents whose absence lets a race finish.

        Args:
            order: the race.
            suspects: indices of the agents that may have ended the process.
            sizes: sizes of the groups to try.
            is_unique: whether the group must be the only one of its size, and not empty.

        Returns:
            Indices of the agents; ``None`` if there is no such group.
        """
        left = _MAX_TRIALS
        for size in sizes:
            groups = [*itertools.combinations(suspects, size)][:left]
            left -= len(groups)
            found = []
            for absent in groups:
                _, is_over = self._run_once(replace(order, absent=absent))
                if is_over and not is_unique:
                    return absent
                found += [absent] if is_over else []
            if found:
                return found[0] if len(found) == 1 and found[0] else None
        return None

    def _report(self, order: RaceOrder, outcome: OrderOutcome, suspects: Sequence[int]) -> None:
        names = ", ".join(order.drivers[number] for number in suspects) or "none"
        reason = outcome.error.partition("\n")[0]
        logger.warning("race %d: %s; it is repeated; suspects: %s", order.number, reason, names)

    def _run_once(self, order: RaceOrder) -> tuple[OrderOutcome, bool]:
        """Runs a race once, and returns its outcome and whether its process is still running."""
        self._was_late = False
        kind = type(order)
        line = {"module": kind.__module__, "class": kind.__name__, "order": asdict(order)}
        text = json.dumps({**line, "folder": self._folder}).encode()
        with self._lock:
            if self._is_closed:
                return OrderOutcome(order, error="the batch was ended"), True
            process, said = self._running = self._running or _start(is_alone=self._is_alone)
        assert process.stdin is not None  # noqa: S101 - opened as pipes
        assert process.stdout is not None  # noqa: S101 - opened as pipes
        watch = threading.Timer(self._timeout, process.kill)
        watch.start()
        try:
            process.stdin.write(text + b"\n")
            process.stdin.flush()
            return OrderOutcome(order, **json.loads(process.stdout.readline())), True
        except (OSError, ValueError):  # the output is closed or incomplete
            self._was_late = watch.finished.is_set()
        finally:
            watch.cancel()
        self._running = None
        error = _end(process, said, _END_TIMEOUT)
        if self._was_late:
            error = f"it was not over after {self._timeout:g} s"
        return OrderOutcome(order, error=error), False

    def close(self) -> None:
        """Ends the process, even during a race."""
        with self._lock:
            self._is_closed = True
        if running := self._running:
            _end(*running)


def _start(*, is_alone: bool) -> tuple[subprocess.Popen[bytes], OutputTail]:
    cores = {} if is_alone else {SHARED_CORES: "1"}  # parallel races would pin the same cores
    process = subprocess.Popen(  # noqa: S603 - our own program
        python_command(_WORKER),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # The worker must find the same modules as this program.
        env={**os.environ, **cores, "PYTHONPATH": os.pathsep.join(search_path())},
        start_new_session=True,  # Ctrl-C must reach only this program, which ends its workers
    )
    return process, OutputTail(process.stderr)


def _end(process: subprocess.Popen[bytes], said: OutputTail, patience: float = 0.0) -> str:
    """Ends a process and returns a description of how it ended.

    Args:
        process: the process.
        said: its error output.
        patience: time for the process to end by itself [s].
    """
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(patience)
    process.kill()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_END_TIMEOUT)
    said.close()
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with contextlib.suppress(OSError):  # close() flushes data that was not sent
                stream.close()
    text = said.text()
    return f"its process ended with code {process.returncode}" + (
        f"; last lines:\n{text}" if text else ""
    )


def serve() -> None:
    """Runs races in a worker process, one after another.

    The worker reads one JSON line per race from standard input, and writes one line with the
    outcome to standard output. It exits as soon as its input is closed, even during a race, so it
    never outlives the program that started it.
    """
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # output of agents must not mix with the answers
    lines: SimpleQueue[dict[str, Any]] = SimpleQueue()
    threading.Thread(target=_read, args=(lines,), daemon=True).start()
    while True:
        answers.write(json.dumps(_run(lines.get())) + "\n")
        answers.flush()


def _read(lines: SimpleQueue[dict[str, Any]]) -> None:
    try:
        for line in sys.stdin:
            lines.put(json.loads(line))
    finally:
        os._exit(0)


def _run(line: dict[str, Any]) -> dict[str, str]:
    try:
        kind = getattr(import_module(line["module"]), line["class"])
        return {"result": msgspec.convert(line["order"], kind).run(Path(line["folder"])).to_json()}
    except StkzooError as error:
        return {"error": str(error)}
    except Exception:  # noqa: BLE001 - the program reports it to the user
        return {"error": traceback.format_exc()}
