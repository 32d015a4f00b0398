"""Compares learners with the bare engine, in kart-steps per second and core.

    python -m benchmarks.learners
    python -m benchmarks.learners --only engine ppo --rounds 3
    python -m benchmarks.learners --only ppo --karts 1 5 20 --races 2 8 --cores 1 2
    python -m benchmarks.learners --only engine ppo --races 4 --per-core --cores 1 4 16

Contenders take turns. Each turn runs in a new interpreter that may use all cores. With every
contender but engine, one policy drives all karts:

    engine  pystk2 alone: one race per core, with recorded controls of the heuristic agent
    ppo     stkzoo.agents.training.ppo.selfplay
    sb3     PPO of Stable-Baselines3 on RaceVecEnv in the view racing
    pytorch the loop of docs/how-to/pytorch.md on RaceVectorEnv in the view racing
    rllib   PPO of Ray RLlib with stkzoo.agents.training.rllib.selfplay, if Ray is installed

The first eight updates are not counted; later resets and learning are. Races copy one of eight
starts. Most starts are made before the measured updates, so a new start is as rare as in a long
run. The time of all cores is divided into shares: the game's processes, observations, networks,
learning, the rest of the programs, and waiting, when a core was idle.
"""

from __future__ import annotations

import argparse
import importlib.util
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from benchmarks.common import (
    RESULTS,
    Result,
    Table,
    cores,
    measure_all,
    parser,
    positive,
    quantiles,
    spread,
)
from benchmarks.contenders.driver import WARMUP, Contender, Spec, answer_of, record_controls
from benchmarks.learners import programs
from benchmarks.learners.shares import SHARES
from stkzoo._os import cpu_count

#: Functions of the learners; the engine has none.
_LEARNERS = {
    "ppo": programs.ppo,
    "sb3": programs.sb3,
    "pytorch": programs.pytorch,
    "rllib": programs.rllib,
}
#: The engine's steps in a round.
_ENGINE_STEPS = 400
_QUICK = {"karts": [2], "races": [1], "rounds": 1, "iterations": 1}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    options = _options().parse_args(arguments)
    if options.quick:
        vars(options).update(_QUICK)
    jobs = [{**job, "round": n} for n in range(options.rounds) for job in _settings(options)]

    def measure(job: Mapping[str, Any]) -> Mapping[str, Any]:
        name, setting = job["name"], [job[key] for key in ("karts", "races", "cores")]
        if name == "engine":
            return {"rate": _engine_rate(*setting, options.track)}
        answer: dict[str, float] = answer_of(
            _LEARNERS[name], *setting, options.track, options.iterations
        )
        return answer

    measure_all(options.output / "learners.json", options, jobs, measure, _tables)
    return 0


def _options() -> argparse.ArgumentParser:
    words = parser("learners", __doc__)
    names = ["engine", *_LEARNERS]
    installed = [n for n in names if n != "rllib" or importlib.util.find_spec("ray")]
    words.add_argument("--only", nargs="+", choices=names, default=installed)
    words.add_argument("--karts", type=positive, nargs="+", default=[10], metavar="K")
    words.add_argument("--races", type=positive, nargs="+", default=[8], metavar="N")
    words.add_argument("--per-core", action="store_true", help="--races counts races per core")
    words.add_argument("--cores", type=int, nargs="+", default=[0], help="0 for all")
    words.add_argument("--track", default="lighthouse", metavar="NAME")
    words.add_argument("--rounds", type=positive, default=5, help="of each contender (default: 5)")
    words.add_argument("--iterations", type=positive, default=12, help="updates (default: 12)")
    words.add_argument("--quick", action="store_true", help="a trial run; figures mean nothing")
    words.add_argument("--output", type=Path, default=RESULTS, help="folder of the JSON file")
    return words


def _settings(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Returns the contender, the karts of a race, the races and the cores of each measurement."""
    settings = []
    for number in options.cores:
        available = number or cpu_count()
        races = {"engine": [available]}
        learners = [n * (available if options.per_core else 1) for n in options.races]
        settings += [
            {"name": name, "karts": karts, "races": count, "cores": number}
            for karts in options.karts
            for name in options.only
            for count in races.get(name, learners)
        ]
    return settings


def _engine_rate(karts: int, count: int, number: int, track: str) -> float:
    """Returns the kart-steps per second and core of races on all cores at once."""
    controls = record_controls(track, karts, karts, WARMUP + _ENGINE_STEPS)
    with ExitStack() as stack, ThreadPoolExecutor(count) as threads:
        spec = Spec("bare", num_kart=karts, num_agents=karts, cores=cores(number))
        races = [stack.enter_context(Contender(spec)) for _ in range(count)]
        for race in races:
            race.ask("load")
            race.ask("make")
            race.ask("reset", track=track, seed=1, controls=controls)
            race.ask("steps", count=WARMUP)
        begin = time.perf_counter()
        list(threads.map(lambda race: race.ask("steps", count=_ENGINE_STEPS), races))
        return float(karts * _ENGINE_STEPS / (time.perf_counter() - begin))


def _tables(results: Sequence[Result]) -> list[Table]:
    groups: dict[tuple[Any, ...], list[Result]] = {}
    for result in results:
        key = tuple(result[name] for name in ("name", "karts", "races", "cores"))
        groups.setdefault(key, []).append(result)
    engines = {
        (result["karts"], result["cores"], result["round"]): result["rate"]
        for result in results
        if result["name"] == "engine"
    }
    columns = ("", "karts", "races", "cores", "kart-steps/s/core", "to engine", "core minutes")
    note = (
        "to engine: the rate relative to the engine's in the same round; core minutes: per million "
        "kart-steps; other columns: shares of the time of all cores"
    )
    rows = [_row(rounds, engines) for rounds in groups.values()]
    return [Table("learners: median (10..90%)", (*columns, *SHARES), rows, note)]


def _row(rounds: Sequence[Result], engines: Mapping[tuple[Any, ...], float]) -> list[str]:
    """Returns the row of a setting from its rounds, and the engine's rates by setting and round."""
    first, rate = rounds[0], quantiles(result["rate"] for result in rounds)
    pairs = [
        (result["rate"], engines.get((result["karts"], result["cores"], result["round"])))
        for result in rounds
    ]
    ratios = [own / engine for own, engine in pairs if engine]
    shares = [
        f"{statistics.median(result[share] for result in rounds):.0%}" if share in first else "-"
        for share in SHARES
    ]
    return [
        first["name"],
        str(first["karts"]),
        str(first["races"]),
        str(first["cores"] or "all"),
        spread(rate),
        spread(quantiles(ratios) if ratios else None, 2),
        f"{1e6 / rate['median'] / 60:.1f}",
        *shares,
    ]


if __name__ == "__main__":
    sys.exit(main())
