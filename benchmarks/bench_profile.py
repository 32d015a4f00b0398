"""Profiles the part of a step outside the engine, by phase and by function.

    python -m benchmarks.bench_profile
    python -m benchmarks.bench_profile --karts 10 --view full --steps 300

First, each phase is timed separately in an in-process race. It is repeated many times, so its
caches are warm; right after a step of the engine, it takes 1.5 times as long. ``update``, ``write``
and ``motion`` belong to the engine: it rebuilds its world, serializes it to bytes, and provides the
karts' attributes that the bytes lack. ``read`` includes the last two and the copying; ``controls``
converts the actions; ``score``, ``observe`` and ``infos`` make the agents' results.

Then stkzoo runs under cProfile, in process and with the default worker, and the functions that take
the most time are listed. The profiler exaggerates the cost of Python calls; ``bench_steps``
measures steps without it.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.bench_common import (
    VIEWS,
    Table,
    cores,
    parser,
    print_tables,
    progress_bar,
    save,
)
from benchmarks.bench_controls import driving_style
from benchmarks.bench_driver import WARMUP, Contender, Spec, record_controls
from stkzoo import race_v0


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser(__doc__, "profile", steps=300, karts=(3, 10, 20), cores=1)
    words.add_argument("--view", nargs="+", choices=VIEWS, default=["full", "flattened"])
    words.add_argument("--top", type=int, default=25, help="functions to list (default: 25)")
    options = words.parse_args(arguments)
    specs = [
        Spec("stkzoo", "parallel", view, karts, karts, is_worker, cores(options.cores))
        for view in options.view
        for karts in options.karts
        for is_worker in (False, True)
    ]
    by_part = [
        {"view": view, "karts": karts, "parts": parts(view, karts, options.track)}
        for view in options.view
        for karts in options.karts
    ]
    print_tables(tables(by_part))
    results: list[dict[str, Any]] = []
    with progress_bar(len(specs)) as (bar, task):
        for spec in specs:
            bar.update(task, description=_title(spec))
            results.append(profile(spec, options))
            bar.advance(task)
    text = "\n".join(
        f"== {_title(spec)}\n{r['text']}" for spec, r in zip(specs, results, strict=True)
    )
    print(text)
    save(options.output, "profile", options, [*by_part, *results])
    _save_text(options.output.with_suffix(".txt"), text)
    return 0


def parts(view: str, karts: int, track: str, repeats: int = 400) -> dict[str, float]:
    """Returns the median duration of each part of a step [µs]."""
    with race_v0.parallel_env(
        num_kart=karts, track=track, view=view, use_subprocess=False, max_cycles=None
    ) as env:
        env.reset(seed=1)
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        for _ in range(WARMUP):
            env.step(actions)
        race: Any = env._session._race  # type: ignore[attr-defined]
        episode: Any = env._episode
        now, seats, chains = episode.snapshot, episode.seats(env.agents), env._chains
        return {
            "update": _median(race._world.update, repeats),
            "write": _median(race._world.__getstate__, repeats),
            "motion": _median(
                lambda: [(k.angular_velocity, k.speed) for k in race._world.karts], repeats
            ),
            "read": _median(lambda: race._stepper.read(True), repeats),
            "controls": _median(lambda: env.decode(actions), repeats),
            "score": _median(lambda: episode._record.score(now, now, seats, False), repeats),
            "observe": _median(lambda: chains.observe(seats, episode), repeats),
            "infos": _median(lambda: episode.infos(seats), repeats),
        }


def _median(function: Callable[[], object], repeats: int) -> float:
    taken = []
    for _ in range(repeats):
        begin = time.perf_counter()
        function()
        taken.append(1e6 * (time.perf_counter() - begin))
    return statistics.median(taken)


def tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Returns the parts of a step as one table."""
    by_part = [result for result in results if "parts" in result]
    names = list(by_part[0]["parts"])
    rows = [
        (row["view"], str(row["karts"]), *(f"{row['parts'][name]:.1f}" for name in names))
        for row in by_part
    ]
    return [Table("parts of a step with warm caches, median [µs]", ("view", "karts", *names), rows)]


def profile(spec: Spec, options: Any) -> dict[str, Any]:
    """Profiles one contender."""
    count = WARMUP + options.steps
    controls = record_controls(
        options.track, spec.num_kart, spec.num_agents, 1, count, driving_style(spec.view)
    )
    with Contender(spec) as contender:
        contender.ask("load")
        contender.ask("make")
        contender.ask("reset", track=options.track, seed=1, controls=controls)
        contender.ask("steps", count=WARMUP)
        text = contender.ask("profile", count=options.steps, top=options.top)
    return {
        "view": spec.view,
        "karts": spec.num_kart,
        "transport": "worker" if spec.subprocess else "in process",
        "text": text,
    }


def _title(spec: Spec) -> str:
    where = "worker" if spec.subprocess else "in process"
    return f"{spec.view}, {spec.num_kart} karts, {where}"


def _save_text(path: Path, text: str) -> None:
    path.write_text("\n".join(line.rstrip() for line in text.splitlines()) + "\n")


if __name__ == "__main__":
    sys.exit(main())
