"""Measures imports, first resets and later resets, compared with the engine's own time.

    python -m benchmarks.bench_resets
    python -m benchmarks.bench_resets --steps 20 --rounds 5 --karts 3

Each round starts new interpreters, one contender after another, and measures the import, the
construction of the environment, the first reset and the first step (in which the reference
compiles). Later resets are then measured in turn. The engine's part of a reset consists of
``Race(config)``, ``start`` and the steps until the karts are on the grid. It is measured repeatedly
in one process and, as in stkzoo's worker, as the first race of a forked process. The start of the
interpreter is not counted; files are in the file system's cache.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.bench_common import (
    Table,
    cores,
    parser,
    progress_bar,
    quantiles,
    save,
    spread,
)
from benchmarks.bench_driver import Contender, Spec

ENGINE, FORK = "engine", "engine, forked"
_FRESH = ("import", "make", "first reset", "first step")


def _specs(karts: int, pinned: tuple[int, ...]) -> dict[str, Spec]:
    def spec(kind: str, api: str, subprocess: bool = False) -> Spec:
        return Spec(kind, api, "full", karts, karts, subprocess, pinned)

    return {
        ENGINE: spec("bare", "parallel"),
        FORK: spec("bare", "parallel"),
        "stkzoo, in process": spec("stkzoo", "parallel"),
        "stkzoo, worker": spec("stkzoo", "parallel", subprocess=True),
        "reference, in process": spec("reference", "multi"),
        "reference, subprocess": spec("reference", "multi", subprocess=True),
    }


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser(__doc__, "resets", steps=20, karts=(3,), cores=0)
    words.add_argument("--rounds", type=int, default=5, help="new interpreters (default: 5)")
    words.epilog = "--steps is the number of later resets of each contender, over all rounds."
    options = words.parse_args(arguments)
    results = []
    with progress_bar(len(options.karts) * options.rounds * 6) as (bar, task):
        for karts in options.karts:
            seconds: Seconds = defaultdict(lambda: defaultdict(list))
            for number in range(options.rounds):
                bar.update(task, description=f"{karts} karts, round {number + 1}")
                _round(seconds, karts, options, lambda: bar.advance(task))
            results.append(_summary(karts, seconds))
    save(options.output, "resets", options, results, tables(results))
    return 0


Seconds = dict[str, dict[str, list[float]]]


def _round(seconds: Seconds, karts: int, options: argparse.Namespace, advance: Any) -> None:
    started: dict[str, Contender] = {}
    try:
        for name, spec in _specs(karts, cores(options.cores)).items():
            started[name] = contender = Contender(spec)
            seconds[name]["import"].append(contender.ask("load"))
            seconds[name]["make"].append(contender.ask("make"))
            seconds[name]["first reset"].append(_reset(name, contender, options.track, 0))
            if name != FORK:
                first_step = contender.ask("steps", count=1)["total"][0]
                seconds[name]["first step"].append(first_step)
            advance()
        for seed in range(1, 1 + -(-options.steps // options.rounds)):
            for name, contender in started.items():
                taken = _reset(name, contender, options.track, seed)
                seconds[name]["later resets"].append(taken)
                if name != FORK:
                    contender.ask("steps", count=1)
    finally:
        for contender in started.values():
            contender.close()


def _reset(name: str, contender: Contender, track: str, seed: int) -> float:
    request = "fork_reset" if name == FORK else "reset"
    return float(contender.ask(request, track=track, seed=seed))


def _summary(karts: int, seconds: Seconds) -> dict[str, Any]:
    again, forked = (statistics.median(seconds[name]["later resets"]) for name in (ENGINE, FORK))
    found: dict[str, Any] = {}
    for name, parts in seconds.items():
        found[name] = {
            part: quantiles(1e3 * value for value in values) for part, values in parts.items()
        }
        fresh = zip(*(parts[part] for part in _FRESH[:3]), strict=True)
        found[name]["to first observation"] = quantiles(1e3 * sum(values) for values in fresh)
        later = statistics.median(parts["later resets"])
        found[name] |= {"to_engine": later / again, "to_forked": later / forked}
    return {"karts": karts, "contenders": found}


def tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Returns one table per number of karts."""
    columns = (*_FRESH, "to first observation", "later resets")
    return [
        Table(
            f"{result['karts']} karts: milliseconds, median (10..90%)",
            ("", *columns, "to engine", "to forked"),
            [
                (
                    name,
                    *(spread(found.get(part), 1) for part in columns),
                    f"{found['to_engine']:.2f}",
                    f"{found['to_forked']:.2f}",
                )
                for name, found in result["contenders"].items()
            ],
            "to engine, to forked: later resets relative to the engine's own, in one process and "
            "as the first race of a forked process",
        )
        for result in results
    ]


if __name__ == "__main__":
    sys.exit(main())
