"""Measures the cost of opponents, as CPU time of the program per step.

One agent races against eight other karts. They are the game's AI, as bots or as the opponents
``ai:3``; or four ``pretrained:ace`` and four ``heuristic``, driven one by one or together. The
alternatives are measured in turn. The engine's process is not counted, because its work is the same
in both alternatives.

    python -m benchmarks.opponents
    python -m benchmarks.opponents --races 1 --steps 100
"""

from __future__ import annotations

import json
import statistics
import time
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_common import host_facts
from stkzoo import RaceVectorEnv
from stkzoo._arguments import CommandParser
from stkzoo.race import Driver, find_driver

RESULTS = Path(__file__).parent / "results" / "opponents.json"
BOTS, DRIVERS = ["ai:3"] * 8, ["pretrained:ace"] * 4 + ["heuristic"] * 4
#: Consecutive steps of one alternative in its turn, and steps before the measured ones.
TURN, WARMUP = 20, 60


def alone(name: str) -> Driver:
    """Returns a driver without the function that drives several of its karts at once."""
    driver = find_driver(name)
    load: Any = driver.load
    return replace(driver, load=lambda stack: replace(load(stack), act_together=None))


def cost(races: int, steps: int, track: str) -> dict[str, float]:
    """Returns the median CPU time of a step [ms] of each alternative, by name.

    Args:
        races: number of parallel races.
        steps: measured steps of each alternative.
        track: name of the track.
    """
    forms: dict[str, list[Any] | None] = {
        "bots": None,
        "ai:3": BOTS,
        "one by one": [*map(alone, DRIVERS)],
        "together": DRIVERS,
    }
    options = {"agents": 1, "num_kart": 9, "view": "racing", "track": track, "difficulty": 3}
    times: dict[str, list[float]] = {form: [] for form in forms}
    with ExitStack() as stack:
        envs = {
            form: stack.enter_context(closing(RaceVectorEnv(races, opponents=own, **options)))
            for form, own in forms.items()
        }
        actions = np.tile([10, 0, 0, 0, 0], (races, 1))  # straight ahead
        for env in envs.values():
            env.reset(seed=1)
        for number in range(0, WARMUP + steps, TURN):
            for form, env in envs.items():
                for _ in range(TURN):
                    begin = time.process_time()
                    env.step(actions)
                    times[form] += [time.process_time() - begin] * (number >= WARMUP)
    return {form: round(1e3 * statistics.median(own), 3) for form, own in times.items()}


def main() -> None:
    """Runs the command."""
    parser = CommandParser(prog="python -m benchmarks.opponents", description=__doc__)
    parser.add_argument("--races", type=int, nargs="+", default=[1, 4], help="parallel races (1 4)")
    parser.add_argument("--track", default="lighthouse", metavar="NAME")
    parser.add_argument("--steps", type=int, default=200, help="steps per measurement (200)")
    parser.add_argument("--output", type=Path, default=RESULTS, help="JSON file to write")
    options = parser.parse_args()
    found = {races: cost(races, options.steps, options.track) for races in options.races}
    for races, own in found.items():
        print(races, "races:", ", ".join(f"{form} {time} ms" for form, time in own.items()))
    options.output.parent.mkdir(parents=True, exist_ok=True)
    report = {"host": host_facts(), "track": options.track, "steps": options.steps, "ms": found}
    options.output.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
