"""Measures the cost of the shipped learned drivers, in µs per kart and decision.

All karts of some races are driven as one batch, as in training and evaluation. Then the decisions
at the recorded moments are repeated without the game; the fastest of several repetitions counts.
Four parts are timed separately: *see* (the karts' surroundings, from snapshots), *plan* (the plans'
worth and the policy's input), *choose* (the policy, its network or ensemble) and *act* (the
controls).

    python -m benchmarks.learned_drivers
    python -m benchmarks.learned_drivers --karts 32 --track black_forest
"""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.bench_common import Table, print_tables
from stkzoo import race_v0
from stkzoo._arguments import CommandParser
from stkzoo.agents.planning.driver import ALL_LOOKS, PlanDriver
from stkzoo.agents.pretrained.driver import read_numbers, read_policy
from stkzoo.tracks import SPLITS
from stkzoo.wrappers.racing import (
    BatchedRacingLines,
    BatchedRacingView,
    RoadTable,
    racing_lines_of,
)

RESULTS = Path(__file__).parent / "results" / "learned_drivers.json"
#: Maximum number of karts in a race.
TOGETHER = 8
TURNS = 5
PARTS = ("see", "plan", "choose", "act")
#: Learned drivers with plans.
NAMES = ["pretrained:ace", "pretrained:apex", "pretrained:scout", "pretrained:zenith"]


@dataclass
class Batch:
    """A learned driver for all karts of some races, with timing.

    Attributes:
        folder: folder of the driver.
        sizes: number of karts of each race.
        batched_view: returns the surroundings of the karts.
        lines: returns the racing lines ahead of the karts.
        marks: times at which the parts of each decision began and ended [s].
    """

    folder: Path
    sizes: Sequence[int]
    batched_view: BatchedRacingView
    lines: BatchedRacingLines
    marks: list[list[float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._policy = read_policy(self.folder)
        self._rules = read_numbers(self.folder)
        self._drivers = PlanDriver(sum(self.sizes), self._rules)
        self._who = [np.arange(size) for size in self.sizes]

    def decide(self, snapshots: Sequence[Any]) -> npt.NDArray[np.float32]:
        """Returns the controls of all karts."""
        marks = [time.perf_counter()]
        karts = snapshots, [0] * len(snapshots), self._who
        own, around = self.batched_view.surroundings(*karts, ALL_LOOKS)
        if self._rules.racing_line:
            around = replace(around, line=self.lines.ahead(*karts))
        marks.append(time.perf_counter())
        view = self._drivers.look(own, around)
        marks.append(time.perf_counter())
        choices = self._policy.best(view)
        marks.append(time.perf_counter())
        controls, _ = self._drivers.act(choices)
        marks.append(time.perf_counter())
        self.marks.append(marks)
        return controls


def cost(name: str, karts: int, track: str, steps: int) -> dict[str, float]:
    """Returns the cost of each part of a decision [µs per kart].

    Args:
        name: name of the driver.
        karts: number of karts in a batch.
        track: name of the track.
        steps: number of recorded moments.
    """
    module: Any = importlib.import_module(f"stkzoo.agents.{name.replace(':', '.')}")
    folder = Path(module.__file__).parent
    sizes = [min(TOGETHER, karts - first) for first in range(0, karts, TOGETHER)]
    moments = []
    with ExitStack() as stack:
        envs = [stack.enter_context(race_v0.parallel_env(num_kart=n, track=track)) for n in sizes]
        for seed, env in enumerate(envs):
            env.reset(seed=seed)
        course, ground = envs[0].track_map, envs[0].ground
        assert course is not None  # noqa: S101 - since reset
        assert ground is not None  # noqa: S101 - since reset
        views = BatchedRacingView([RoadTable(course)]), racing_lines_of(course, ground)
        batch = Batch(folder, sizes, *views)
        for _ in range(steps):
            moments.append([env.snapshot for env in envs])
            controls = np.split(batch.decide(moments[-1]), np.cumsum(sizes)[:-1])
            for env, own in zip(envs, controls, strict=True):
                env.send(own)
            for env in envs:
                env.step_wait()
    turns = []
    for _ in range(TURNS):
        batch = Batch(folder, sizes, *views)
        for snapshots in moments:
            batch.decide(snapshots)
        turns.append(np.diff(batch.marks).mean(axis=0) / karts * 1e6)
    best = min(turns, key=np.sum)
    return dict(zip(PARTS, best.round(1).tolist(), strict=True))


def main() -> None:
    """Runs the command."""
    parser = CommandParser(prog="python -m benchmarks.learned_drivers", description=__doc__)
    parser.add_argument(
        "--karts", type=int, nargs="+", default=[1, 32, 128], help="batch sizes (1 32 128)"
    )
    parser.add_argument("--track", choices=SPLITS["all"], default="lighthouse", metavar="NAME")
    parser.add_argument("--steps", type=int, default=100, help="number of moments (100)")
    parser.add_argument("--output", type=Path, default=RESULTS, help="JSON file to write")
    options = parser.parse_args()
    found = {
        name: {karts: cost(name, karts, options.track, options.steps) for karts in options.karts}
        for name in NAMES
    }
    rows = [
        (name, str(karts), *(f"{number:.0f}" for number in (*parts.values(), sum(parts.values()))))
        for name, by_karts in found.items()
        for karts, parts in by_karts.items()
    ]
    print_tables([Table("A decision [µs a kart]", ("driver", "karts", *PARTS, "all"), rows)])
    options.output.parent.mkdir(parents=True, exist_ok=True)
    report = {"track": options.track, "steps": options.steps, "us": found}
    options.output.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
