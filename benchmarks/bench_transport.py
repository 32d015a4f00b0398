"""Measures the cost of running the game in a separate process.

    python -m benchmarks.bench_transport
    python -m benchmarks.bench_transport --cores 0 --karts 3

The same race runs in process and in the default worker, a few steps each in turn. The figures per
step are:

- ``step``: time of the worker's step minus that of the in-process step;
- ``outside the engine``: the same without the time inside ``pystk2.Race.step``, whose noise exceeds
  the measured difference; this is the cost of the transport;
- ``pipes alone``: the lower bound, measured right afterwards: two processes that send the same
  number of bytes back and forth over pipes, while the other process is busy for as long as the
  engine.

``--cores 1`` pins the program and the game to one core, so that no wake-up crosses cores.
"""

from __future__ import annotations

import argparse
import functools
import os
import signal
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

from benchmarks.bench_common import (
    KARTS,
    VIEWS,
    Table,
    add_driving,
    cores,
    parser,
    progress_bar,
    quantiles,
    save,
    spread,
)
from benchmarks.bench_driver import Spec, Times, contenders, race_together

HERE, THERE = "stkzoo, in process", "stkzoo, worker"


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser(__doc__, "transport", steps=300, karts=KARTS, cores=[1, 0])
    add_driving(words)
    words.add_argument("--view", nargs="+", choices=VIEWS, default=["flattened"])
    options = words.parse_args(arguments)
    todo = [
        (n, view, karts) for n in options.cores for view in options.view for karts in options.karts
    ]
    results = []
    with progress_bar(2 * len(todo) * options.steps) as (bar, task):
        for number, view, karts in todo:
            bar.update(task, description=f"{view}, {karts} karts, cores: {number or 'all'}")
            advance = functools.partial(bar.advance, task)
            results.append(measure(number, view, karts, options, advance))
    save(options.output, "transport", options, results, tables(results))
    return int(not all(result["same_race"] for result in results))


def measure(
    number: int, view: str, karts: int, options: argparse.Namespace, advance: Callable[[int], None]
) -> dict[str, Any]:
    """Measures both contenders on a number of cores; returns their part of the results."""
    specs = {
        name: Spec("stkzoo", "parallel", view, karts, karts, name == THERE, cores(number))
        for name in (HERE, THERE)
    }
    with contenders(specs) as started:
        times, is_same = race_together(
            started,
            track=options.track,
            steps=options.steps,
            driving=options.driving,
            advance=advance,
        )
    return {
        "view": view,
        "karts": karts,
        "cores": number or "all",
        "same_race": is_same,
        **differences(times[HERE], times[THERE]),
        "pipes_alone": quantiles(
            pipes_alone(
                options.steps,
                busy=statistics.median(times[THERE]["engine"]),
                there=64 + 24 * karts,
                back=400 * karts,
                on=cores(number),
            )
        ),
    }


def pipes_alone(
    steps: int, *, busy: float, there: int, back: int, on: Sequence[int]
) -> list[float]:
    """Returns the round-trip times of messages without the other process's work [µs].

    Args:
        steps: number of messages.
        busy: duration of the other process's work per message [s].
        there: size of a message [bytes].
        back: size of the answer [bytes].
        on: cores of both processes; empty for all.
    """
    inbox, outbox = os.pipe(), os.pipe()
    child = os.fork()
    if child == 0:
        _echo(inbox[0], outbox[1], busy, bytes(back), on)
    own = os.sched_getaffinity(0) if on else set()
    try:
        if on:
            os.sched_setaffinity(0, on)
        taken = []
        for _ in range(steps):
            begin = time.perf_counter()
            os.write(inbox[1], bytes(there))
            os.read(outbox[0], back)
            taken.append(1e6 * (time.perf_counter() - begin - busy))
            _work(1e-4)  # as a learner would
        return taken
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        for end in (*inbox, *outbox):
            os.close(end)
        if on:
            os.sched_setaffinity(0, own)


def _echo(inbox: int, outbox: int, busy: float, answer: bytes, on: Sequence[int]) -> NoReturn:
    if on:
        os.sched_setaffinity(0, on)
    while os.read(inbox, 65536):
        _work(busy)
        os.write(outbox, answer)
    os._exit(0)


def _work(seconds: float) -> None:
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        pass


def differences(here: Times, there: Times) -> dict[str, Any]:
    """Returns quantiles of the worker's additional time [µs]; see the module's docstring."""
    outside = {
        name: _minus(times["total"], times["engine"])
        for name, times in ((HERE, here), (THERE, there))
    }
    found = {
        "step": _minus(there["total"], here["total"]),
        "outside_engine": _minus(outside[THERE], outside[HERE]),
    }
    return {
        name: quantiles(1e6 * v for v in values) if values else None
        for name, values in found.items()
    }


def _minus(left: Sequence[Any], right: Sequence[Any]) -> list[float]:
    if None in left or None in right:
        return []
    return [a - b for a, b in zip(left, right, strict=False)]


def tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Returns the results as one table."""
    columns = ("view", "karts", "cores", "step", "outside the engine", "pipes alone")
    rows = [
        (
            result["view"],
            str(result["karts"]),
            str(result["cores"]),
            spread(result["step"]),
            spread(result["outside_engine"]),
            spread(result["pipes_alone"]),
        )
        for result in results
    ]
    return [Table("what the worker adds to a step [µs], median (10..90%)", columns, rows)]


if __name__ == "__main__":
    sys.exit(main())
