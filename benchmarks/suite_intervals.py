"""Counts how often intervals over few training runs contain the mean behind them.

    python -m benchmarks.suite_intervals    # two minutes

Draws the scores of runs on six tracks in both directions from normal distributions with known
means. A score is the sum of a part of the track, a part of the run, and a part of both. The parts
of the two directions of a track are correlated. The command compares the bootstrap of
``stkzoo.suite.report.statistics`` with three others: one resamples each column independently, like
the stratified bootstrap of rliable, one resamples whole runs only, and one resamples runs and
columns, as if the directions were independent. Writes ``benchmarks/results/suite_intervals.json``.
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
from stkzoo.suite.report.statistics import (
    DRAWS,
    ScoreTable,
    estimate,
    interquartile_mean,
    mean,
)

OUTPUT = RESULTS / "suite_intervals.json"
#: Number of runs, standard deviations of the parts of the track, of the run and of both, and
#: correlation of the directions of a track.
CASES = (
    *((runs, 0.15, 0.05, 0.08, alike) for alike in (0.0, 0.5, 1.0) for runs in (3, 5, 10)),
    (3, 0.05, 0.05, 0.05, 0.5),
    (3, 0.10, 0.10, 0.05, 0.5),
)
_TRACKS, _DIRECTIONS = 6, 2

FloatArray = npt.NDArray[np.float64]
Ends = tuple[float, float]


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = CommandParser(prog="python -m benchmarks.suite_intervals", description=__doc__)
    words.add_argument("--trials", type=int, default=500, help="trials of each case")
    words.add_argument("--output", type=Path, default=OUTPUT, help="JSON file to write")
    options = words.parse_args(arguments)
    rows = [coverage(*case, options.trials) for case in track(CASES, "cases")]
    write_text(
        options.output, json.dumps({"trials": options.trials, "rows": rows}, indent=1) + "\n"
    )
    return 0


def coverage(
    runs: int, by_track: float, by_run: float, by_both: float, alike: float, trials: int
) -> dict[str, float]:
    """Returns a case and, for each bootstrap, the fraction of intervals that contain the mean.

    On other tracks, it also returns that of the intervals of the interquartile mean.

    Args:
        runs: number of training runs.
        by_track: standard deviation of the part that all runs have on a track.
        by_run: standard deviation of the part that a run has on all tracks.
        by_both: standard deviation of the rest.
        alike: correlation of the parts of the track and of both between directions.
        trials: number of trials.
    """
    random = np.random.default_rng(0)
    hits = dict.fromkeys(
        (f"{name}, {kind}" for name in BOOTSTRAPS for kind in ("same", "other")), 0
    )
    hits["IQM, other"] = 0
    for _ in range(trials):
        tracks = by_track * _parts(random, 1, alike)
        noise = by_both * _parts(random, runs, alike)
        scores = tracks + random.normal(0, by_run, (runs, 1)) + noise
        for name, ends_of in BOOTSTRAPS.items():
            low, high = ends_of(scores)
            hits[f"{name}, same"] += bool(low <= tracks.mean() <= high)  # new runs, these tracks
            hits[f"{name}, other"] += bool(low <= 0 <= high)  # new runs on new tracks
        low, high = estimate(interquartile_mean, _table(scores)).interval
        hits["IQM, other"] += bool(low <= 0 <= high)
    case = {"runs": runs, "by_track": by_track, "by_run": by_run, "by_both": by_both}
    return case | {"alike": alike} | {name: count / trials for name, count in hits.items()}


def _parts(random: np.random.Generator, rows: int, alike: float) -> FloatArray:
    """Returns standard normal values ``(rows, 12)``; those of a track are correlated."""
    of_track = random.normal(size=(rows, _TRACKS)).repeat(_DIRECTIONS, axis=1)
    own = random.normal(size=of_track.shape)
    return np.asarray(np.sqrt(alike) * of_track + np.sqrt(1 - alike) * own)


def _table(scores: FloatArray, directions: int = _DIRECTIONS) -> ScoreTable:
    return ScoreTable(scores, "runs", "tracks", directions)


def _by_score(scores: FloatArray) -> Ends:
    generator = np.random.default_rng(0)
    rows = generator.integers(len(scores), size=(DRAWS, *scores.shape))
    return _ends(scores[rows, np.arange(scores.shape[1])].mean(axis=(1, 2)))


def _by_run(scores: FloatArray) -> Ends:
    generator = np.random.default_rng(0)
    return _ends(
        scores.mean(axis=1)[generator.integers(len(scores), size=(DRAWS, len(scores)))].mean(1)
    )


def _by_run_and_column(scores: FloatArray) -> Ends:
    return estimate(mean, _table(scores, 1)).interval


def _by_run_and_track(scores: FloatArray) -> Ends:
    return estimate(mean, _table(scores)).interval


def _ends(draws: FloatArray) -> Ends:
    low, high = percentile_interval(draws).tolist()
    return low, high


BOOTSTRAPS: dict[str, Callable[[FloatArray], Ends]] = {
    "each score": _by_score,
    "runs": _by_run,
    "runs and columns": _by_run_and_column,
    "runs and tracks": _by_run_and_track,
}


if __name__ == "__main__":
    sys.exit(main())
