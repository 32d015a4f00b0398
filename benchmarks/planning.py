"""Compares the planner, which searches in copies of the race, with its own base policy.

One kart races alone, or against the game's AI at its highest level: once driven by the base policy
(pretrained:ace), and once by the planner, which searches around the choices of that driver
(docs/how-to/planning.md). Both drive the same tracks and seeds, so the races start identically.

    python -m benchmarks.planning
    python -m benchmarks.planning --track hacienda lighthouse --seeds 3
    python -m benchmarks.planning --rivals 4

Each race is saved when it ends, and the same command resumes an interrupted run. Races that are
already in the file are not repeated: after a change of the planner, use --again or delete the file.
"""

from __future__ import annotations

import itertools
import json
import statistics
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.bench_common import Table, print_tables
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text
from stkzoo.agents.planner import PlannerSettings
from stkzoo.evaluation import load_ai_times
from stkzoo.race import run_race
from stkzoo.tracks import SPLITS, TRAIN_TRACKS

RESULTS = Path(__file__).parent / "results" / "planning.json"
DIFFICULTY = 3
DRIVERS = ("pretrained:ace", "planner")


@dataclass(frozen=True)
class Result:
    """Result of a race.

    Attributes:
        track: name of the track.
        rivals: number of karts driven by the game's AI.
        seed: seed of the race.
        driver: name of the driver.
        finish_time: finish time on the game's clock [s]; ``None`` if the kart did not finish.
        rank: final rank.
        rescues: number of rescues.
        seconds: computing time [s].
    """

    track: str
    rivals: int
    seed: int
    driver: str
    finish_time: float | None
    rank: int
    rescues: int
    seconds: float

    @property
    def key(self) -> tuple[str, int, int, str]:
        """Identifies the race."""
        return self.track, self.rivals, self.seed, self.driver

    @property
    def ratio(self) -> float | None:
        """The finish time as a fraction of the AI's median time on the track."""
        median = load_ai_times().of(self.track, reverse=False, difficulty=DIFFICULTY).median
        return self.finish_time / median if self.finish_time and median else None


def race(track: str, rivals: int, seed: int, driver: str) -> Result:
    """Runs a race to the finish."""
    start = time.perf_counter()
    drivers = [driver, *["ai"] * rivals]
    result = run_race(drivers, wait_for=[0], track=track, seed=seed, difficulty=DIFFICULTY)
    (own,) = (row for row in result.agents if row.agent == "kart_0")
    finish_time = own.finish_time and round(own.finish_time, 3)
    seconds = round(time.perf_counter() - start, 1)
    return Result(track, rivals, seed, driver, finish_time, own.rank, own.rescues, seconds)


def load(path: Path) -> dict[Any, Result]:
    """Returns the races in a file."""
    if not path.exists():
        return {}
    races = [Result(**row) for row in json.loads(path.read_text())["races"]]
    return {own.key: own for own in races}


def save(path: Path, results: dict[Any, Result]) -> None:
    """Writes all races."""
    path.parent.mkdir(parents=True, exist_ok=True)
    races = [asdict(results[key]) for key in sorted(results)]
    report = {"settings": asdict(PlannerSettings()), "difficulty": DIFFICULTY, "races": races}
    write_text(path, json.dumps(report, indent=1) + "\n")


def main() -> None:
    """Runs the command."""
    parser = CommandParser(prog="python -m benchmarks.planning", description=__doc__)
    parser.add_argument(
        "--track",
        nargs="+",
        choices=SPLITS["all"],
        default=TRAIN_TRACKS,
        metavar="NAME",
        help="tracks (default: the training tracks)",
    )
    parser.add_argument("--seeds", type=int, default=1, help="races on each track (default: 1)")
    parser.add_argument("--rivals", type=int, default=0, help="karts of the AI (default: 0)")
    parser.add_argument("--again", action="store_true", help="repeat races that are in the file")
    parser.add_argument("--output", type=Path, default=RESULTS, help="JSON file")
    options = parser.parse_args()
    results = load(options.output)
    races = list(itertools.product(options.track, [options.rivals], range(options.seeds), DRIVERS))
    for key in races:
        if options.again or key not in results:
            results[key] = race(*key)
            save(options.output, results)
    print_tables([_table([results[key] for key in races])])


def _table(results: list[Result]) -> Table:
    title = "Finish time as a fraction of the AI's median time, lower is better"
    rows, pairs = [], []
    for base, planned in zip(results[::2], results[1::2], strict=True):
        cells = [_cell(base), _cell(planned), ""]
        if base.ratio is not None and planned.ratio is not None:
            pairs.append((base.ratio, planned.ratio))
            cells[-1] = f"{base.ratio - planned.ratio:+.3f}"
        rows.append((base.track, str(base.seed), *cells))
    if pairs:
        means = [statistics.mean(ratios) for ratios in zip(*pairs, strict=True)]
        gain = f"{means[0] - means[1]:+.3f}"
        rows.append(("mean", "", *(f"{mean:.3f}" for mean in means), gain))
    return Table(title, ("track", "seed", *DRIVERS, "gain"), rows)


def _cell(result: Result) -> str:
    if result.ratio is None:
        return "not finished"
    return f"{result.ratio:.3f}" + (f" (place {result.rank})" if result.rivals else "")


if __name__ == "__main__":
    main()
