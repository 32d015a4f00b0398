"""Measures agent-steps per second of many parallel races.

    python -m benchmarks.bench_vector
    python -m benchmarks.bench_vector --steps 300 --rounds 5 --races 1 2

There are two groups. ``slots`` is :class:`stkzoo.RaceVectorEnv` with an increasing number of races,
all karts as agents, on all cores; the gain is relative to one race in the same round. ``single``
are two races of one agent each in the ``flattened`` view, with the other karts driven by the game,
compared with pystk2-gymnasium's ``make_stkrace_vec``; the gain is relative to that. All karts drive
straight ahead at full throttle. Every figure comes from a separate interpreter; contenders take
turns.
"""

from __future__ import annotations

import argparse
import importlib
import json
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.bench_common import (
    Table,
    parser,
    progress_bar,
    quantiles,
    save,
    spread,
)
from benchmarks.bench_driver import answer_of, engine_variables

_SINGLE_RACES = 2
_SINGLE = ("stkzoo, RaceVectorEnv", "stkzoo, make_stkrace_vec", "reference, make_stkrace_vec")
_WARM_UP = 40


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser(__doc__, "vector", steps=300, karts=(10,))
    words.add_argument("--races", type=int, nargs="+", default=[1, 2, 4], help="races (1 2 4)")
    words.add_argument("--rounds", type=int, default=3, help="measurements of each (default: 3)")
    words.add_argument("--contender", help=argparse.SUPPRESS)
    options = words.parse_args(arguments)
    if options.contender:
        print(json.dumps(_rate(json.loads(options.contender), options)))
        return 0
    todo = _contenders(options)
    rates: dict[str, list[float]] = {name: [] for name in todo}
    with progress_bar(len(todo) * options.rounds) as (bar, task):
        for _ in range(options.rounds):
            for name, spec in todo.items():
                bar.update(task, description=name)
                rates[name].append(_in_an_interpreter_of_its_own(spec, options))
                bar.advance(task)
    results = _results(todo, rates)
    save(options.output, "vector", options, results, tables(results))
    return 0


def _contenders(options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    found = {
        _slots(races, karts): {"group": "slots", "races": races, "karts": karts}
        for karts in options.karts
        for races in options.races
    }
    return found | {name: {"group": "single", "who": name, "karts": 3} for name in _SINGLE}


def _in_an_interpreter_of_its_own(spec: Mapping[str, Any], options: argparse.Namespace) -> float:
    words = ["--steps", str(options.steps), "--track", options.track]
    return answer_of("bench_vector", spec, words, engine_variables())


def _rate(spec: Mapping[str, Any], options: argparse.Namespace) -> float:
    """Returns agent-steps per second."""
    envs = _vector(spec, options.track)
    try:
        envs.reset(seed=1)
        action = _straight_ahead(envs)
        for _ in range(_WARM_UP):
            envs.step(action)
        begin = time.perf_counter()
        for _ in range(options.steps):
            envs.step(action)
        return float(options.steps * envs.num_envs / (time.perf_counter() - begin))
    finally:
        envs.close()


def _vector(spec: Mapping[str, Any], track: str) -> Any:
    race = {"num_kart": spec["karts"], "track": track}
    if spec["group"] == "slots":
        from stkzoo import RaceVectorEnv

        return RaceVectorEnv(spec["races"], max_cycles=None, view="flattened", **race)
    if spec["who"] == _SINGLE[0]:
        from stkzoo import RaceVectorEnv

        return RaceVectorEnv(_SINGLE_RACES, agents=1, view="flattened", **race)
    library = importlib.import_module("stkzoo" if spec["who"] == _SINGLE[1] else "pystk2_gymnasium")
    return library.make_stkrace_vec(_SINGLE_RACES, "supertuxkart/flattened-v0", env_kwargs=race)


def _straight_ahead(envs: Any) -> dict[str, Any]:
    spaces = envs.single_action_space
    continuous = np.tile(np.array([1, 0], np.float32), (envs.num_envs, 1))
    discrete = np.zeros((envs.num_envs, *spaces["discrete"].shape), np.int64)
    return {"continuous": continuous, "discrete": discrete}


def _results(
    todo: Mapping[str, Mapping[str, Any]], rates: Mapping[str, Sequence[float]]
) -> list[dict[str, Any]]:
    results = []
    for name, spec in todo.items():
        base = rates.get(_base_of(spec), ())
        gains = [own / its for own, its in zip(rates[name], base, strict=False)]
        results.append(
            {
                "group": spec["group"],
                "contender": name,
                "agent_steps_per_second": quantiles(rates[name]),
                "gain": statistics.median(gains) if gains else None,
            }
        )
    return results


def _slots(races: int, karts: int) -> str:
    return f"{races} x {karts} karts"


def _base_of(spec: Mapping[str, Any]) -> str:
    """Returns the name of the contender that ``spec`` is compared with."""
    return _SINGLE[2] if spec["group"] == "single" else _slots(1, spec["karts"])


def tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Returns one table per group."""
    notes = {"slots": "gain: relative to one race", "single": "gain: relative to the reference"}
    return [
        Table(
            f"{group}: agent-steps a second, median (10..90%)",
            ("", "agent-steps/s", "gain"),
            [
                (
                    result["contender"],
                    spread(result["agent_steps_per_second"]),
                    "" if result["gain"] is None else f"{result['gain']:.2f}",
                )
                for result in results
                if result["group"] == group
            ],
            notes[group],
        )
        for group in dict.fromkeys(result["group"] for result in results)
    ]


if __name__ == "__main__":
    sys.exit(main())
