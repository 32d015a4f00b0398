"""Compares the planner, which looks ahead with the real game, with its own base policy.

One kart races against two of the game's bots to the finish: once driven by the heuristic driver,
and once by the planner, which tries changes of that driver's actions in copies of the race
(docs/how-to/planning.md). Both drive the same tracks and seeds, so the races start identically.

    python benchmarks/planning.py
    python benchmarks/planning.py --track olivermath --seeds 5
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from stkzoo import RaceParallelEnv, race_v0
from stkzoo.agents.heuristic import create_state
from stkzoo.agents.planner import Planner, PlannerSettings
from stkzoo.tracks import SPLITS

RESULTS = Path(__file__).parent / "results" / "planning.json"
#: The driver needs to see some way ahead, not the whole track at every step.
MAX_PATHS = 60

Act = Callable[[RaceParallelEnv, Any], dict[str, Any]]


@dataclass(frozen=True)
class Result:
    """One race.

    Attributes:
        track: the track's name.
        seed: of the race.
        driver: who drove.
        finish_time: on the game's clock [s]; ``None`` if the race was cut short.
        position: rank at the end.
        seconds: how long the race took to compute.
    """

    track: str
    seed: int
    driver: str
    finish_time: float | None
    position: int
    seconds: float


def heuristic() -> Act:
    """The base policy alone."""
    driver = create_state()
    return lambda env, observation: driver.drive(observation)  # noqa: ARG005 - as the planner


DRIVERS: dict[str, Callable[[int], Act]] = {
    "heuristic": lambda _: heuristic(),
    "planner": lambda seed: Planner(seed=seed).act,
}


def race(track: str, seed: int, driver: str) -> Result:
    """One race to the finish."""
    act = DRIVERS[driver](seed)
    start = time.perf_counter()
    with race_v0.parallel_env(agents=1, num_kart=3, track=track, max_paths=MAX_PATHS) as env:
        observations, infos = env.reset(seed=seed)
        while env.agents:
            observations, _, _, _, infos = env.step({"kart_0": act(env, observations["kart_0"])})
    info = infos["kart_0"]
    return Result(
        track=track,
        seed=seed,
        driver=driver,
        finish_time=round(info["finish_time"], 2) or None,
        position=info["position"],
        seconds=round(time.perf_counter() - start, 1),
    )


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--track",
        nargs="+",
        choices=SPLITS["all"],
        default=["olivermath", "lighthouse"],
        metavar="NAME",
    )
    parser.add_argument("--seeds", type=int, default=3, help="number of races of each (default: 3)")
    parser.add_argument("--output", type=Path, default=RESULTS, help="JSON file to write")
    options = parser.parse_args()
    results = [
        race(track, seed, driver)
        for track in options.track
        for seed in range(1, options.seeds + 1)
        for driver in DRIVERS
    ]
    options.output.parent.mkdir(parents=True, exist_ok=True)
    report = {"settings": asdict(PlannerSettings()), "races": [asdict(r) for r in results]}
    options.output.write_text(json.dumps(report, indent=2) + "\n")
    Console().print(_table(results))


def _table(results: list[Result]) -> Table:
    table = Table(title="Finish time \\[s], lower is better", box=box.SIMPLE)
    for name in ("track", "seed", *DRIVERS, "gain"):
        table.add_column(name, justify="left" if name == "track" else "right")
    gains = []
    for base, planned in zip(results[::2], results[1::2], strict=True):
        times = base.finish_time, planned.finish_time
        gain = times[0] - times[1] if times[0] and times[1] else None
        gains += [gain] if gain is not None else []
        cells = [
            f"{t:.2f} (place {r.position})" if t else "cut short"
            for t, r in zip(times, (base, planned), strict=True)
        ]
        table.add_row(base.track, str(base.seed), *cells, "" if gain is None else f"{gain:+.2f}")
    if gains:
        table.add_section()
        table.add_row("mean", "", "", "", f"{statistics.mean(gains):+.2f}")
    return table


if __name__ == "__main__":
    main()
