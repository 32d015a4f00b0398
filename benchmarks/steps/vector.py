"""Agent-steps per second of many parallel races.

``slots`` is :class:`stkzoo.RaceVectorEnv` with an increasing number of races, all karts as agents,
on all cores. ``single`` are two races of one agent each in the ``flattened`` view, with the other
karts driven by the game, compared with pystk2-gymnasium's ``make_stkrace_vec``. All karts drive
straight ahead at full throttle. Contenders take turns, each in a new interpreter.
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.common import Result, Table, quantiles, spread
from benchmarks.contenders.driver import WARMUP, answer_of
from benchmarks.steps.sections import Job, Section

_SINGLE = ("stkzoo, RaceVectorEnv", "stkzoo, make_stkrace_vec", "reference, make_stkrace_vec")
_SINGLE_RACES, _SINGLE_KARTS = 2, 3


def _jobs(options: argparse.Namespace) -> list[Job]:
    slots = [
        {"group": "slots", "contender": "stkzoo, RaceVectorEnv", "races": races, "karts": karts}
        for karts in options.karts
        for races in options.races
    ]
    single = [
        {"group": "single", "contender": name, "races": _SINGLE_RACES, "karts": _SINGLE_KARTS}
        for name in _SINGLE
    ]
    return [{**job, "round": n} for n in range(options.rounds) for job in slots + single]


def _measure(job: Job, options: argparse.Namespace) -> Mapping[str, Any]:
    return {"agent_steps_per_second": answer_of(rate_of, job, options.track[0], options.steps)}


def rate_of(job: Job, track: str, steps: int) -> float:
    """Returns the agent-steps per second of a job."""
    envs = _races(job, track)
    try:
        envs.reset(seed=1)
        action = _straight_ahead(envs)
        for _ in range(WARMUP):
            envs.step(action)
        begin = time.perf_counter()
        for _ in range(steps):
            envs.step(action)
        return float(steps * envs.num_envs / (time.perf_counter() - begin))
    finally:
        envs.close()


def _races(job: Job, track: str) -> Any:
    race = {"num_kart": job["karts"], "track": track}
    if job["contender"] == _SINGLE[0]:
        from stkzoo import RaceVectorEnv

        own = {"agents": 1} if job["group"] == "single" else {"max_cycles": None}
        return RaceVectorEnv(job["races"], view="flattened", **own, **race)
    name = "stkzoo" if job["contender"] == _SINGLE[1] else "pystk2_gymnasium"
    make = importlib.import_module(name).make_stkrace_vec
    return make(job["races"], "supertuxkart/flattened-v0", env_kwargs=race)


def _straight_ahead(envs: Any) -> dict[str, Any]:
    spaces = envs.single_action_space
    continuous = np.tile(np.array([1, 0], np.float32), (envs.num_envs, 1))
    discrete = np.zeros((envs.num_envs, *spaces["discrete"].shape), np.int64)
    return {"continuous": continuous, "discrete": discrete}


def _tables(results: Sequence[Result]) -> list[Table]:
    rates: dict[tuple[Any, ...], list[float]] = {}
    for result in results:
        key = tuple(result[name] for name in ("group", "contender", "races", "karts"))
        rates.setdefault(key, []).append(result["agent_steps_per_second"])
    rows = [
        (group, contender, str(races), str(karts), spread(quantiles(values)))
        for (group, contender, races, karts), values in rates.items()
    ]
    columns = ("group", "", "races", "karts", "agent-steps/s")
    return [Table("parallel races: agent-steps a second, median (10..90%)", columns, rows)]


VECTOR = Section(
    "agent-steps per second of parallel races, also of the reference's",
    _jobs,
    _measure,
    _tables,
    {"steps": 300, "rounds": 3, "karts": [10], "races": [1, 2, 4], "track": ["lighthouse"]},
    {"steps": 5, "rounds": 1, "karts": [2], "races": [1, 2]},
)
