"""What the view ``racing`` costs: in the kernel, and in numpy, which does the same without it.

All karts of one race, at the same moments, turn by turn; the quickest of several turns.

    python benchmarks/racing_view.py
    python benchmarks/racing_view.py --karts 1 20 --track black_forest
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from stkzoo import race_v0
from stkzoo.kernel import IS_COMPILED
from stkzoo.tracks import SPLITS
from stkzoo.wrappers.racing import BatchedRacingView, RoadTable, racing_features

RESULTS = Path(__file__).parent / "results" / "racing_view.json"
#: Steps before the moments that are seen, and how many of these there are.
WARMUP, MOMENTS = 40, 50
TURNS = 7


def cost(karts: int, track: str) -> dict[str, float]:
    """Microseconds for all karts of a race at once, in the kernel and in numpy."""
    with race_v0.parallel_env(num_kart=karts, track=track, view="racing") as env:
        env.reset(seed=1)
        for agent, space in env.action_spaces.items():
            space.seed(int(agent.rpartition("_")[2]))
        snapshots = []
        for _ in range(WARMUP + MOMENTS):
            env.step({agent: env.action_space(agent).sample() for agent in env.agents})
            snapshots.append(env.snapshot)
        assert env.track_map is not None  # noqa: S101 - since reset
        crowd = BatchedRacingView([RoadTable(env.track_map)])
    who = [np.arange(karts)]
    ways: dict[str, Callable[[object], object]] = {
        "kernel": lambda snapshot: crowd.observe([snapshot], [0], who),
        "numpy": lambda snapshot: racing_features(*crowd.surroundings([snapshot], [0], who)),
    }
    best = dict.fromkeys(ways, float("inf"))
    for _ in range(TURNS):
        for name, see in ways.items():
            begin = time.perf_counter()
            for snapshot in snapshots[WARMUP:]:
                see(snapshot)
            best[name] = min(best[name], (time.perf_counter() - begin) / MOMENTS * 1e6)
    return {name: round(value, 1) for name, value in best.items()}


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--karts", type=int, nargs="+", default=[1, 4, 8], help="(1 4 8)")
    parser.add_argument("--track", choices=SPLITS["all"], default="lighthouse", metavar="NAME")
    parser.add_argument("--output", type=Path, default=RESULTS, help="where the JSON goes")
    options = parser.parse_args()
    if not IS_COMPILED:
        parser.error("there is no kernel here to compare; see `stkzoo doctor`")
    found = {karts: cost(karts, options.track) for karts in options.karts}
    table = Table(title="The view racing, all karts of a race [µs]", box=box.SIMPLE)
    for name in ("karts", "kernel", "numpy", "times"):
        table.add_column(name, justify="right")
    for karts, one in found.items():
        ratio = f"{one['numpy'] / one['kernel']:.0f}"
        table.add_row(str(karts), f"{one['kernel']:.1f}", f"{one['numpy']:.1f}", ratio)
    Console().print(table)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps({"track": options.track, "us": found}, indent=2) + "\n")


if __name__ == "__main__":
    main()
