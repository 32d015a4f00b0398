"""Imports, resets and saved states."""

from __future__ import annotations

import argparse
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from benchmarks.common import Result, Table, cores, quantiles, spread
from benchmarks.contenders.driver import Contender, Spec
from benchmarks.steps.sections import Job, Section
from stkzoo import race_v0

# ---------------------------------------------------------------------- resets

_FRESH = ("import", "make", "first reset", "first step")
_CONTENDERS = {
    "engine": ("bare", "parallel", False),
    "stkzoo, in process": ("stkzoo", "parallel", False),
    "stkzoo, worker": ("stkzoo", "parallel", True),
    "reference, in process": ("reference", "multi", False),
    "reference, subprocess": ("reference", "multi", True),
}


def _measure_resets(job: Job, options: argparse.Namespace) -> Mapping[str, Any]:
    """Measures new interpreters in each round, then later resets of all contenders in turn.

    The engine's part of a reset consists of ``Race(config)``, ``start`` and the steps until the
    karts are on the grid. The start of the interpreter is not counted; files are in the file
    system's cache.
    """
    seconds: dict[str, dict[str, list[float]]] = {name: defaultdict(list) for name in _CONTENDERS}
    for _ in range(options.rounds):
        _one_round(seconds, job["karts"], options)
    base = statistics.median(seconds["engine"]["later resets"])
    result = {}
    for name, parts in seconds.items():
        fresh = zip(*(parts[part] for part in _FRESH[:3]), strict=True)
        result[name] = {part: quantiles(1e3 * s for s in taken) for part, taken in parts.items()}
        result[name]["to first observation"] = quantiles(1e3 * sum(taken) for taken in fresh)
        result[name]["to_engine"] = statistics.median(parts["later resets"]) / base
    return {"contenders": result}


def _one_round(seconds: Mapping[str, Any], karts: int, options: argparse.Namespace) -> None:
    track, started = options.track[0], {}
    try:
        for name, (kind, api, subprocess) in _CONTENDERS.items():
            pinned = cores(options.cores[0])
            contender = Contender(Spec(kind, api, "full", karts, karts, subprocess, pinned))
            started[name] = contender
            seconds[name]["import"].append(contender.ask("load"))
            seconds[name]["make"].append(contender.ask("make"))
            seconds[name]["first reset"].append(contender.ask("reset", track=track, seed=0))
            first_step = contender.ask("steps", count=1)["total"][0]
            seconds[name]["first step"].append(first_step)
        for seed in range(1, 1 + -(-options.steps // options.rounds)):
            for name, contender in started.items():
                seconds[name]["later resets"].append(contender.ask("reset", track=track, seed=seed))
                contender.ask("steps", count=1)
    finally:
        for contender in started.values():
            contender.close()


def _reset_tables(results: Sequence[Result]) -> list[Table]:
    columns = (*_FRESH, "to first observation", "later resets")
    return [
        Table(
            f"{result['karts']} karts: milliseconds, median (10..90%)",
            ("", *columns, "to engine"),
            [
                (
                    name,
                    *(spread(parts.get(part), 1) for part in columns),
                    f"{parts['to_engine']:.2f}",
                )
                for name, parts in result["contenders"].items()
            ],
            "to engine: later resets relative to the engine's own",
        )
        for result in results
    ]


RESETS = Section(
    "import, first reset, first step and later resets, compared with the engine's race start",
    lambda options: [{"karts": karts} for karts in options.karts],
    _measure_resets,
    _reset_tables,
    {"steps": 20, "rounds": 5, "karts": [3], "track": ["lighthouse"], "cores": [0]},
    {"steps": 1, "rounds": 1},
)

# ---------------------------------------------------------------------- saved states

_PARTS = ("save", "restore", "first step", "clone", "reset to a parked start", "reset")


def _measure_states(job: Job, options: argparse.Namespace) -> Mapping[str, Any]:
    """Saves, restores and clones a race, and starts it again, in turn.

    The first step after a copy is slow because processes share memory until they write to it.
    """
    taken: dict[str, list[float]] = defaultdict(list)

    def timed(part: str, function: Callable[..., Any], *arguments: Any, **words: Any) -> Any:
        begin = time.perf_counter()
        result = function(*arguments, **words)
        taken[part].append(1e3 * (time.perf_counter() - begin))
        return result

    with race_v0.parallel_env(
        num_kart=job["karts"], track=options.track[0], view="flattened_discrete", max_cycles=None
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
    return {part: quantiles(taken[part]) for part in _PARTS}


def _state_tables(results: Sequence[Result]) -> list[Table]:
    rows = [
        (str(result["karts"]), *(spread(result[part], 1) for part in _PARTS)) for result in results
    ]
    return [Table("milliseconds, median (10..90%)", ("karts", *_PARTS), rows)]


STATES = Section(
    "saving the state of a race, restoring and cloning it, and resetting to it",
    lambda options: [{"karts": karts} for karts in options.karts],
    _measure_states,
    _state_tables,
    {"steps": 60, "karts": [3, 10], "track": ["lighthouse"]},
    {"steps": 1, "karts": [2]},
)
