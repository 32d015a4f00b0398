"""Measures the cost of saving a race, restoring it, cloning it, and starting from a saved state.

    python -m benchmarks.bench_states
    python -m benchmarks.bench_states --steps 100 --karts 3 10

A turn consists of ``save_state``, a few steps, ``restore_state``, the first step after it,
``clone``, a ``reset`` to a saved start, and an ordinary reset. The first step after a copy is slow
because processes share memory until they write to it.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.bench_common import (
    Table,
    parser,
    progress_bar,
    quantiles,
    save,
    spread,
)

_PARTS = ("save", "restore", "first step", "clone", "reset to a parked start", "reset")


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    options = parser(__doc__, "states", steps=60, karts=(3, 10)).parse_args(arguments)
    results = []
    with progress_bar(len(options.karts) * options.steps) as (bar, task):
        for karts in options.karts:
            bar.update(task, description=f"{karts} karts")
            results.append(measure(karts, options, lambda: bar.advance(task)))
    save(options.output, "states", options, results, tables(results))
    return 0


def measure(karts: int, options: argparse.Namespace, advance: Any) -> dict[str, Any]:
    """Measures with one number of karts."""
    from stkzoo import race_v0

    taken: dict[str, list[float]] = defaultdict(list)

    def timed(part: str, function: Any, *arguments: Any, **words: Any) -> Any:
        begin = time.perf_counter()
        result = function(*arguments, **words)
        taken[part].append(1e3 * (time.perf_counter() - begin))
        return result

    with race_v0.parallel_env(
        num_kart=karts, track=options.track, view="flattened_discrete", max_cycles=None
    ) as env:
        env.reset(seed=1)
        start = env.save_state()
        actions = dict.fromkeys(env.agents, 4)
        for _ in range(options.steps):
            for _ in range(10):
                env.step(actions)
            state = timed("save", env.save_state)
            for _ in range(5):
                env.step(actions)
            timed("restore", env.restore_state, state)
            timed("first step", env.step, actions)
            state.close()
            timed("clone", env.clone).close()
            timed("reset to a parked start", env.reset, options={"state": start})
            timed("reset", env.reset, seed=1)
            advance()
    return {"karts": karts, **{part: quantiles(taken[part]) for part in _PARTS}}


def tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Returns the results as a table."""
    return [
        Table(
            "milliseconds, median (10..90%)",
            ("karts", *_PARTS),
            [
                (str(result["karts"]), *(spread(result[part], 1) for part in _PARTS))
                for result in results
            ],
        )
    ]


if __name__ == "__main__":
    sys.exit(main())
