"""Races teams of two algorithms of the suite against each other.

    python -m benchmarks.suite_teams ippo blind        # does it pay to see one's mates?
    python -m benchmarks.suite_teams mappo ippo --seeds 10

The teams of the runs ``team-2v2-ippo-0`` and ``team-2v2-blind-0`` race against each other, then
those of the next training seed, and so on: on the test tracks in both directions, each team in
front in half of the races. The JSON file has the share of pairs of rivals in which the kart of the
first algorithm ranks ahead: for each pair of runs, and in the mean with the 95% interval over pairs
of runs by Student's t. It is 0.5 if no algorithm is better.
"""

from __future__ import annotations

import itertools
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any, ClassVar

from rich.console import Console

from benchmarks.common import RESULTS, host_facts, parser, positive
from stkzoo._os import write_text
from stkzoo.evaluation import BatchProgress, RunOptions
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.evaluation.batch.plan import BatchPlan
from stkzoo.evaluation.batch.run import BatchKind, RaceResults
from stkzoo.evaluation.benchmark.races import race_seed
from stkzoo.race import RaceSettings
from stkzoo.suite import find_task
from stkzoo.suite.report.statistics import estimate_t
from stkzoo.suite.tasks import DIFFICULTY

TASK = find_task("team-2v2")
_TEAM = len(TASK.teams[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class TeamsPlan(BatchPlan):
    """The plan of the races between two teams.

    Attributes:
        teams: folders of the agents of both teams.
        seeds: races for each track, direction and order of the grid.
    """

    type_name: ClassVar[str] = "teams-plan"
    noun: ClassVar[str] = "comparison"
    resume_command: ClassVar[str] = "python -m benchmarks.suite_teams --folder {folder}"

    teams: tuple[str, str]
    seeds: int

    def orders(self) -> list[RaceOrder]:
        """Returns the orders of all races."""
        grids = [self.teams, self.teams[::-1]]
        races = itertools.product(self.tracks, (False, True), range(self.seeds), enumerate(grids))
        return [
            RaceOrder(
                number,
                tuple(team for team in grid for _ in range(_TEAM)),
                RaceSettings(
                    track=track,
                    reverse=reverse,
                    difficulty=DIFFICULTY,
                    seed=race_seed(track, reverse, TASK.forms[0], str(end), index),
                ),
            )
            for number, (track, reverse, index, (end, grid)) in enumerate(races)
        ]


def share_ahead(plan: TeamsPlan, results: RaceResults, _: Path) -> float:
    """Returns the share of pairs of rivals in which the kart of the first team ranks ahead."""
    shares = []
    for result in results.values():
        ranks: dict[str, list[int]] = {}
        for row in result.agents:
            ranks.setdefault(row.source, []).append(row.rank)
        pairs = itertools.product(*(ranks[team] for team in plan.teams))
        shares.append(fmean(first < second for first, second in pairs))
    return fmean(shares)


COMPARISON = BatchKind(TeamsPlan, share_ahead, lambda *_: None, is_partial=False)


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser("suite_teams", __doc__)
    words.add_argument("algorithms", nargs=2, metavar="ALGORITHM")
    words.add_argument("--seeds", type=positive, default=3, help="races of each track and grid")
    words.add_argument("--jobs", type=positive, help="races at the same time (default: all cores)")
    words.add_argument("--folder", type=Path, default=Path("runs/suite"), help="folder of the runs")
    words.add_argument("--output", type=Path, default=RESULTS / "suite", help="of the JSON file")
    options = words.parse_args(arguments)
    console = Console(stderr=True)
    shares: dict[int, float] = {}
    for seed in itertools.count():
        runs = [options.folder / f"{TASK.name}-{name}-{seed}" for name in options.algorithms]
        if not all((run / "agent").is_dir() for run in runs):
            break
        first, second = (str(run / "agent") for run in runs)
        plan = TeamsPlan(teams=(first, second), tracks=TASK.test_tracks, seeds=options.seeds)
        with console.status(f"runs {seed}") as status:

            def show(progress: BatchProgress, status: Any = status, seed: int = seed) -> None:
                status.update(f"runs {seed}: {progress.done} of {progress.total} races")

            folder = runs[0] / f"against-{options.algorithms[1]}"
            races = RunOptions(options.jobs, on_race=show, plot=False)
            shares[seed] = COMPARISON.run(plan, folder, races)
        console.print(f"runs {seed}: {shares[seed]:.3f}")
    if not shares:
        words.error(f"{runs[0]} or {runs[1]} has no agent; train them (suite_reference)")
    ahead = asdict(estimate_t([*shares.values()]))
    content = {"host": host_facts(), "algorithms": options.algorithms, "ahead": ahead}
    options.output.mkdir(parents=True, exist_ok=True)
    file = options.output / f"teams-{'-'.join(options.algorithms)}.json"
    write_text(file, json.dumps({**content, "of_runs": shares}, indent=1) + "\n")
    console.print(ahead)
    return 0


if __name__ == "__main__":
    sys.exit(main())
