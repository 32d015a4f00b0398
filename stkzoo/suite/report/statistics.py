"""Statistics over training runs: interquartile means, comparisons, power, with intervals.

Most functions work on tables ``(R, C)`` of the scores of ``R`` runs in ``C`` columns, which are the
tracks and directions of an evaluation. Higher scores are better. The interquartile mean and the
probability of improvement are those of Agarwal et al. (2021).

Their bootstrap resamples each column on its own, because a column there is a task with its own
training runs. Here, one run drives all columns of a task, so a good run is good in all of them. A
run that fails on a track often fails in both directions. The bootstrap therefore resamples whole
runs, and whole tracks with both directions, independently of each other (Owen 2007). As in
:mod:`stkzoo.evaluation.statistics`, it draws one less than there are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from statistics import NormalDist, fmean, stdev

import numpy as np
import numpy.typing as npt

from stkzoo.evaluation.statistics import (
    CONFIDENCE,
    DRAWS,
    Estimate,
    percentile_interval,
    student_t,
)

FloatArray = npt.NDArray[np.float64]
#: Function of tables ``(..., R, C)`` that returns one value for each.
Statistic = Callable[..., FloatArray]

#: Minimum number of runs for an interval; a single run does not show how much runs differ.
FEWEST_RUNS = 2
#: Probability with which a difference is to be detected.
POWER = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class ScoreTable:
    """The scores of an algorithm's runs.

    Attributes:
        scores: score of each run in each column, ``(R, C)``.
        runs: name of the set of runs. Tables with the same name are of the same runs.
        tracks: name of the set of tracks. Tables with the same name have the same columns.
        directions: number of columns of each track, which are neighbors.
    """

    scores: FloatArray
    runs: Hashable
    tracks: Hashable
    directions: int

    @property
    def of_runs(self) -> list[float]:
        """Mean score of each run."""
        values: list[float] = self.scores.mean(axis=1).tolist()
        return values

    @property
    def of_tracks(self) -> list[float]:
        """Mean score on each track."""
        values: list[float] = self.scores.mean(axis=0).reshape(-1, self.directions).mean(1).tolist()
        return values


def estimate_t(values: Sequence[float]) -> Estimate:
    """Returns the mean of independent values with its 95% interval by Student's t.

    Args:
        values: the values, such as the mean score of each run or on each track.

    Returns:
        The estimate. A single value, or equal values, have no interval.
    """
    count, mean = len(values), fmean(values)
    if count < FEWEST_RUNS or min(values) == max(values):
        return Estimate(mean, None, None)
    margin = student_t(count - 1) * stdev(values) / math.sqrt(count)
    return Estimate(mean, mean - margin, mean + margin)


def runs_needed(deviation: float, difference: float) -> int:
    """Returns how many runs of each of two algorithms detect a difference with 80% power.

    They detect it if a two-sided t test of equal sizes at 5% does. The noncentral t distribution is
    approximated (Abramowitz and Stegun 1964, 26.7.10).

    Args:
        deviation: standard deviation between the runs of an algorithm, above 0.
        difference: difference of the means.
    """
    size = difference / deviation
    normal = sum(NormalDist().inv_cdf(share) for share in ((1 + CONFIDENCE) / 2, POWER))
    count = max(FEWEST_RUNS, math.floor(2 * (normal / size) ** 2))  # a t test needs at least these
    while _power(count, size) < POWER:
        count += 1
    return count


def _power(count: int, size: float) -> float:
    """Returns the power of a t test of two groups whose means differ by ``size`` deviations."""
    freedom = 2 * count - 2
    limit, shift = student_t(freedom), size * math.sqrt(count / 2)
    spread = math.sqrt(1 + limit**2 / (2 * freedom))
    return NormalDist().cdf((shift - limit * (1 - 1 / (4 * freedom))) / spread)


def estimate(statistic: Statistic, *tables: ScoreTable) -> Estimate:
    """Returns a statistic with a 95% bootstrap interval over runs and tracks.

    Args:
        statistic: function that takes as many tables ``(..., R, C)`` as there are, and returns one
            value for each ``(...,)``.
        *tables: the tables. Those with the same runs, or the same tracks, are resampled together.

    Returns:
        The estimate. It has no interval if a table has fewer than :data:`FEWEST_RUNS` runs, or if
        all draws are equal.
    """
    value = float(statistic(*(table.scores for table in tables)))
    if min(len(table.scores) for table in tables) < FEWEST_RUNS:
        return Estimate(value, None, None)
    low, high = percentile_interval(statistic(*_resampled(tables))).tolist()
    if low == high:
        return Estimate(value, None, None)
    return Estimate(value, min(low, value), max(high, value))


def _resampled(tables: Sequence[ScoreTable]) -> list[FloatArray]:
    """Returns resampled tables ``(DRAWS, R - 1, C - D)``, where ``D`` are the directions."""
    generator = np.random.default_rng(0)
    drawn: dict[tuple[str, Hashable], npt.NDArray[np.int64]] = {}

    def draw(axis: str, name: Hashable, count: int) -> npt.NDArray[np.int64]:
        if (axis, name) not in drawn:
            size = DRAWS, max(count - 1, 1)
            drawn[axis, name] = generator.integers(count, size=size)
        return drawn[axis, name]

    resampled = []
    for table in tables:
        rows = draw("runs", table.runs, table.scores.shape[0])
        tracks = draw("tracks", table.tracks, table.scores.shape[1] // table.directions)
        columns = tracks[:, :, None] * table.directions + np.arange(table.directions)
        resampled.append(table.scores[rows[:, :, None], columns.reshape(DRAWS, 1, -1)])
    return resampled


# ------------------------------------------------------------------ statistics


def mean(scores: FloatArray) -> FloatArray:
    """Returns the mean of tables ``(..., R, C)``."""
    return np.asarray(scores.mean(axis=(-2, -1)))


def interquartile_mean(scores: FloatArray) -> FloatArray:
    """Returns the interquartile mean of tables ``(..., R, C)``: the mean of their middle half.

    If a quarter of the scores is no whole number, the scores at both ends of the middle half count
    in part. ``scipy.stats.trim_mean`` leaves out fewer scores then, for example none of two.
    """
    values = scores.reshape(*scores.shape[:-2], -1)
    count = values.shape[-1]
    ends = np.clip(np.arange(count + 1), count / 4, count * 3 / 4)
    shares = np.diff(ends) / (count / 2)
    return np.asarray((np.sort(values, axis=-1) * shares).sum(axis=-1))


def improvement(first: FloatArray, second: FloatArray) -> FloatArray:
    """Returns the probability that a run of one algorithm is better than one of another.

    It is the mean over columns of the share of pairs of runs in which the first is better; ties
    count half.

    Args:
        first: table ``(..., R, C)`` of the first algorithm.
        second: table ``(..., S, C)`` of the second algorithm.
    """
    one, other = first[..., :, None, :], second[..., None, :, :]
    better = (one > other) + 0.5 * (one == other)
    return np.asarray(better.mean(axis=(-3, -2, -1)))


def gap(train: FloatArray, test: FloatArray) -> FloatArray:
    """Returns how much higher the mean score is on training tracks than on test tracks.

    Args:
        train: table ``(..., R, C)`` on the training tracks.
        test: table ``(..., R, D)`` of the same runs on the test tracks.
    """
    return mean(train) - mean(test)
