"""Compares the environment's event counts with events derived from recorded trajectories.

    python -m benchmarks.events            # 20 races; writes benchmarks/results/events.json

In each race, one kart rams others, one leaves the road, one drives the wrong way, and the game
drives three more. The race is recorded in every physics tick (120 Hz). The counter sees every
twelfth tick, like an environment with steps of 0.1 s; ``events_truth`` sees all ticks. Then the
heuristic driver races alone, to check that no false events are counted.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.events_races import RATE, TICKS, Recording, record
from benchmarks.events_truth import truth_of
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text
from stkzoo.mdp.events import EVENTS, RaceEvents

RESULTS = Path(__file__).parent / "results" / "events.json"
TRACKS = (
    *("abyss", "cornfield_crossing", "hacienda", "lighthouse", "olivermath"),
    *("sandtrack", "scotland", "snowmountain", "volcano_island", "zengarden"),
)
SCRIPTS = ("rammer", "cutter", "ghost")

Totals = dict[str, npt.NDArray[np.float64]]


def main() -> None:
    parser = CommandParser(prog="python -m benchmarks.events", description=__doc__)
    parser.add_argument("--races", type=int, default=20, help="races with scripted karts")
    parser.add_argument("--solo", type=int, default=10, help="races of the heuristic driver alone")
    parser.add_argument("--seconds", type=float, default=60.0, help="duration of a race")
    parser.add_argument("--seed", type=int, default=100, help="seed of the first race")
    parser.add_argument("--output", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    results: dict[str, Any] = {"seed": arguments.seed, "seconds": arguments.seconds}
    for name, count, scripts, bots in (
        ("scripted", arguments.races, SCRIPTS, 3),
        ("solo", arguments.solo, ("expert",), 0),
    ):
        rows = []
        for number in range(count):
            track, seed = TRACKS[number % len(TRACKS)], arguments.seed + number
            race = record(track, seed, scripts, bots=bots, seconds=arguments.seconds)
            rows.append({"track": track, "seed": seed} | compare(race))
            print(name, track, seed, flush=True)
        results[name] = {"totals": totals(rows), "races": rows}
        show(name, results[name]["totals"])
    write_text(arguments.output, json.dumps(results, indent=1) + "\n")


def counted(race: Recording) -> Totals:
    """Returns the counts of the environment at steps of 0.1 s, ``(K,)`` by event."""
    events = RaceEvents(race.track, TICKS / RATE, len(race.moments[0].karts))
    sums = np.zeros_like(events.counts)
    steps = race.moments[::TICKS]
    for before, after in pairwise(steps):
        events.count(before, after)
        sums += events.counts
    return dict(zip(EVENTS, sums.T, strict=True))


def compare(race: Recording) -> dict[str, Any]:
    """Returns the counted and the true number by script and event."""
    found, truth = counted(race), truth_of(race)
    return {
        script: {
            name: [round(float(of[name][kart]), 1) for of in (found, truth)] for name in EVENTS
        }
        for kart, script in race.scripts.items()
    }


def totals(rows: list[dict[str, Any]]) -> dict[str, dict[str, float | None]]:
    """Returns sums by event: counted, true, error [%], and excess and missed counts per kart."""
    karts = [found for row in rows for found in row.values() if isinstance(found, dict)]
    sums = {}
    for name in EVENTS:
        pairs = np.array([found[name] for found in karts])
        (found, true), error = pairs.sum(0), pairs[:, 0] - pairs[:, 1]
        percent = 100.0 * (found - true) / true if true else None
        parts = found, true, percent, error.clip(0.0).sum(), (0.0 - error).clip(0.0).sum()
        keys = "counted", "true", "percent", "too_many", "missed"
        rounded = (None if part is None else round(float(part), 1) for part in parts)
        sums[name] = dict(zip(keys, rounded, strict=True))
    return sums


def show(name: str, sums: dict[str, dict[str, float | None]]) -> None:
    """Prints the table of a group of races."""
    print("\n" + f"{name:14}" + "".join(f"{key:>10}" for key in next(iter(sums.values()))))
    for event, row in sums.items():
        print(
            f"{event:14}" + "".join(f"{'-' if part is None else part:>10}" for part in row.values())
        )


if __name__ == "__main__":
    main()
