"""Counts how often intervals over few training runs contain the mean behind them.

    python -m benchmarks.suite_intervals    # a minute

Draws the scores of runs on twelve tracks and directions from normal distributions with known means.
A score is the sum of a part of the track, a part of the run, and a part of both. The command
compares the bootstrap of ``stkzoo.suite.report.statistics`` with two others: one resamples each
column independently, like the stratified bootstrap of rliable, and one resamples whole runs only.
Writes ``benchmarks/results/suite_intervals.json``.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich.progress import track

from benchmarks.bench_common import RESULTS
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text
from stkzoo.evaluation import percentile_interval
from stkzoo.suite.report.statistics import DRAWS, ScoreTable, estimate, mean

OUTPUT = RESULTS / "suite_intervals.json"
#: Number of runs, and standard deviations of the parts of the track, of the run and of both.
CASES = (
    (3, 0.15, 0.05, 0.08),
    (5, 0.15, 0.05, 0.08),
    (10, 0.15, 0.05, 0.08),
    (3, 0.05, 0.05, 0.05),
    (3, 0.10, 0.10, 0.05),
)
_COLUMNS = 12

FloatArray = npt.NDArray[np.float64]
Ends = tuple[float, float]


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = CommandParser(prog="python -m benchmarks.suite_intervals", description=__doc__)
    words.add_argument("--trials", type=int, default=1000, help="trials of each case")
    words.add_argument("--output", type=Path, default=OUTPUT, help="JSON file to write")
    options = words.parse_args(arguments)
    rows = [coverage(*case, options.trials) for case in track(CASES, "cases")]
    write_text(
        options.output, json.dumps({"trials": options.trials, "rows": rows}, indent=1) + "\n"
    )
    return 0


def coverage(
    runs: int, by_track: float, by_run: float, by_both: float, trials: int
) -> dict[str, float]:
    """Returns a case and, for each bootstrap, the fraction of intervals that contain the mean.

    Args:
        runs: number of training runs.
        by_track: standard deviation of the part that all runs have on a track.
        by_run: standard deviation of the part that a run has on all tracks.
        by_both: standard deviation of the rest.
        trials: number of trials.
    """
    random = np.random.default_rng(0)
    hits = dict.fromkeys(
        (f"{name}, {kind}" for name in BOOTSTRAPS for kind in ("same", "other")), 0
    )
    for _ in range(trials):
        tracks = random.normal(0, by_track, _COLUMNS)
        noise = random.normal(0, by_both, (runs, _COLUMNS))
        scores = tracks + random.normal(0, by_run, (runs, 1)) + noise
        for name, ends_of in BOOTSTRAPS.items():
            low, high = ends_of(scores)
            hits[f"{name}, same"] += bool(low <= tracks.mean() <= high)  # new runs, these tracks
            hits[f"{name}, other"] += bool(low <= 0 <= high)  # new runs on new tracks
    case = {"runs": runs, "by_track": by_track, "by_run": by_run, "by_both": by_both}
    return case | {name: count / trials for name, count in hits.items()}


def _by_score(scores: FloatArray) -> Ends:
    generator = np.random.default_rng(0)
    rows = generator.integers(len(scores), size=(DRAWS, *scores.shape))
    return _ends(scores[rows, np.arange(scores.shape[1])].mean(axis=(1, 2)))


def _by_run(scores: FloatArray) -> Ends:
    generator = np.random.default_rng(0)
    return _ends(
        scores.mean(axis=1)[generator.integers(len(scores), size=(DRAWS, len(scores)))].mean(1)
    )


def _by_run_and_track(scores: FloatArray) -> Ends:
    return estimate(mean, ScoreTable(scores, "runs", "tracks")).interval


def _ends(draws: FloatArray) -> Ends:
    low, high = percentile_interval(draws).tolist()
    return low, high


BOOTSTRAPS: dict[str, Callable[[FloatArray], Ends]] = {
    "each score": _by_score,
    "runs": _by_run,
    "runs and tracks": _by_run_and_track,
}


if __name__ == "__main__":
    sys.exit(main())
