"""A pool of worker processes that run races: its client and the program of a worker."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import traceback
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import msgspec

from stkzoo._imports import python_command, search_path
from stkzoo._temporary import remove_stale_folders
from stkzoo.drivers.failures import OutputTail
from stkzoo.drivers.sandbox import SHARED_CORES
from stkzoo.errors import StkzooError
from stkzoo.evaluation.batch.order import RaceOrder

_END_TIMEOUT = 5.0  # [s]
_WORKER = "from stkzoo.evaluation.batch.pool import serve; serve()"


#: The result of a race as JSON, and why it could not be run; one of them is empty.
Outcome = tuple[str, str]


def run_in_parallel(
    orders: Sequence[RaceOrder], folder: Path, jobs: int, race_timeout: float
) -> Generator[tuple[RaceOrder, Outcome], None, None]:
    """Runs races in parallel and yields each order with its outcome as soon as its race ends.

    Closing the generator ends the running races.

    Args:
        orders: the races.
        folder: folder of the batch.
        jobs: maximum number of races at the same time.
        race_timeout: time limit of a race [s], after which its process is killed. The race is
            repeated once with a time budget for each agent.
    """
    count = min(jobs, len(orders))
    workers = [_Worker(folder, race_timeout, is_alone=count == 1) for _ in range(count)]
    idle: SimpleQueue[_Worker] = SimpleQueue()
    for worker in workers:
        idle.put(worker)

    def run(order: RaceOrder) -> tuple[RaceOrder, Outcome]:
        worker = idle.get()  # does not wait, because each running thread has a worker
        try:
            return order, worker.run(order)
        finally:
            idle.put(worker)

    threads = ThreadPoolExecutor(max(count, 1))
    try:
        for future in as_completed([threads.submit(run, order) for order in orders]):
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
        self._is_closed = False

    def run(self, order: RaceOrder) -> Outcome:
        """Runs a race. If its process ends, the outcome is an error.

        A race that takes too long is repeated with a time budget for each agent, so that no agent
        voids a race that it is about to lose.
        """
        for attempt in (order, order.hurried(self._timeout)):
            if (outcome := self._run_once(attempt)) is not None:
                return outcome
        return "", f"it was not over after {self._timeout:g} s"

    def _run_once(self, order: RaceOrder) -> Outcome | None:
        """Runs a race once; returns ``None`` if it takes too long."""
        order_type = type(order)
        line = {"module": order_type.__module__, "class": order_type.__name__}
        text = json.dumps({**line, "order": asdict(order), "folder": self._folder}).encode()
        with self._lock:
            if self._is_closed:
                return "", "the batch was ended"
            process, said = self._running = self._running or _start(is_alone=self._is_alone)
        assert process.stdin is not None  # noqa: S101 - opened as pipes
        assert process.stdout is not None  # noqa: S101 - opened as pipes
        watch = threading.Timer(self._timeout, process.kill)
        watch.start()
        try:
            process.stdin.write(text + b"\n")
            process.stdin.flush()
            result, error = json.loads(process.stdout.readline())
        except (OSError, ValueError):  # the output is closed or incomplete
            is_late = watch.finished.is_set()
        else:
            return result, error
        finally:
            watch.cancel()
        self._running = None
        error = _end(process, said, _END_TIMEOUT)
        return None if is_late else ("", error + _remedy(order))

    def close(self) -> None:
        """Ends the process, even during a race."""
        with self._lock:
            self._is_closed = True
        if running := self._running:
            _end(*running)


def _remedy(order: RaceOrder) -> str:
    """Returns how to keep an agent from ending the process of a race; empty if it cannot."""
    if not order.settings.inline and order.settings.sandbox != "off":
        return ""
    return "; if an agent ended it, run agents in a sandbox: without --inline or --sandbox off"


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


def _run(line: dict[str, Any]) -> Outcome:
    try:
        order_type = getattr(import_module(line["module"]), line["class"])
        result = msgspec.convert(line["order"], order_type).run(Path(line["folder"]))
    except StkzooError as error:
        return "", str(error)
    except Exception:  # noqa: BLE001 - the program reports it to the user
        return "", traceback.format_exc()
    return result.to_json(), ""
