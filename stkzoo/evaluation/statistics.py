"""Means over races, with bootstrap intervals within strata and over clusters."""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

#: Coverage probability of all intervals that stkzoo reports.
CONFIDENCE = 0.95
#: Number of draws of all bootstraps.
DRAWS = 2000
#: Minimum number of clusters for an interval; fewer do not show how much clusters differ.
FEWEST_CLUSTERS = 4


@dataclass(frozen=True, slots=True)
class Estimate:
    """A mean with an interval.

    Attributes:
        value: the mean over races.
        low: lower end of the interval; ``None`` if there are too few races for an interval.
        high: upper end of the interval; ``None`` as for ``low``.
    """

    value: float
    low: float | None
    high: float | None

    @property
    def interval(self) -> tuple[float, float]:
        """Both ends of the interval; the value itself if there is no interval."""
        if self.low is None or self.high is None:
            return self.value, self.value
        return self.low, self.high

    def __str__(self) -> str:
        """Returns for example ``0.512 (0.480..0.550)``, or ``0.512`` without an interval."""
        if self.low is None or self.high is None:
            return f"{self.value:.3f}"
        return f"{self.value:.3f} ({self.low:.3f}..{self.high:.3f})"


def estimate_mean(
    values: Sequence[float | None],
    strata: Sequence[Hashable],
    bounds: tuple[float, float] | None = None,
) -> Estimate | None:
    """Returns the mean of one value per race, with a 95% bootstrap interval.

    The bootstrap resamples the races within each stratum, and draws one race less than the
    stratum has. The variance of the resampled means then matches that of the mean, even in small
    strata (McCarthy and Snowden 1985).

    Args:
        values: value of each race; ``None`` if a race has none.
        strata: stratum of each race. Strata stay the same when the experiment is repeated. A
            stratum with only one race gives no information about variance, so the result has no
            interval.
        bounds: lowest and highest possible value, for fractions and counts. If all races of each
            stratum agree, the bootstrap has no spread. The interval then extends from the mean by
            ``1 - 0.025 ** (1 / n)`` for ``n`` races, the upper bound for the probability of an
            event that did not occur in ``n`` trials.

    Returns:
        The estimate; ``None`` if no race has a value.
    """
    members: dict[Hashable, list[float]] = {}
    for value, stratum in zip(values, strata, strict=True):
        if value is not None:
            members.setdefault(stratum, []).append(value)
    count = sum(map(len, members.values()))
    if not count:
        return None
    mean = math.fsum(itertools.chain(*members.values())) / count
    if min(map(len, members.values())) < 2:
        return Estimate(mean, None, None)
    if bounds is not None and all(min(group) == max(group) for group in members.values()):
        margin = 1 - ((1 - CONFIDENCE) / 2) ** (1 / count)
        return Estimate(mean, max(bounds[0], mean - margin), min(bounds[1], mean + margin))
    low, high = percentile_interval(_resampled_means(list(members.values()), count))
    # If all races agree, sums in different orders can differ in the last digit.
    return Estimate(mean, min(float(low), mean), max(float(high), mean))


def estimate_clustered(
    totals: npt.NDArray[np.float64],
    counts: npt.NDArray[np.float64],
) -> Estimate | None:
    """Returns the mean over clusters of values, with a 95% bootstrap interval over clusters.

    The bootstrap resamples whole clusters, one less than there are, as in :func:`estimate_mean`.
    The interval covers other clusters of the same kind, such as other tracks. Percentiles of few
    clusters give too narrow intervals, so the tails are those of Student's t distribution
    (expanded percentile interval: Hesterberg 2015).

    Args:
        totals: sum of the values in each cluster, ``(C,)``.
        counts: number of values in each cluster, ``(C,)``. Clusters without values are left out.

    Returns:
        The estimate, without an interval if fewer than :data:`FEWEST_CLUSTERS` clusters have
        values, or if all have the same mean; ``None`` if no cluster has values.
    """
    has_values = counts > 0
    if not has_values.any():
        return None
    totals, counts = totals[has_values], counts[has_values]
    mean, clusters = float(totals.sum() / counts.sum()), len(counts)
    if clusters < FEWEST_CLUSTERS or not np.ptp(totals / counts):
        return Estimate(mean, None, None)
    generator = np.random.default_rng(0)
    drawn = generator.multinomial(clusters - 1, np.full(clusters, 1 / clusters), DRAWS)
    means = (drawn @ totals) / (drawn @ counts)
    tail = 100 * NormalDist().cdf(-student_t(clusters - 1))
    low, high = np.percentile(means, (tail, 100 - tail))
    return Estimate(mean, float(low), float(high))


def student_t(freedom: int) -> float:
    """Returns the 97.5% quantile of Student's t, by bisection of the angle ``atan(t / sqrt(n))``.

    The probability is exact (Abramowitz and Stegun 1964, 26.7.3 and 26.7.4).

    Args:
        freedom: degrees of freedom ``n``, 1 or more.
    """
    low, high = 0.0, math.pi / 2
    for _ in range(60):
        angle = (low + high) / 2
        sine, cosine = math.sin(angle), math.cos(angle)
        is_odd = freedom % 2
        term, total = cosine if is_odd else 1.0, 0.0
        for factor in range(2 + is_odd, freedom + 1, 2):
            total += term
            term *= cosine**2 * (factor - 1) / factor
        within = 2 / math.pi * (angle + sine * total) if is_odd else sine * total
        low, high = (angle, high) if within < CONFIDENCE else (low, angle)
    return math.sqrt(freedom) * math.tan(low)


def percentile_interval(draws: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Returns both ends ``(2, ...)`` of the central 95% interval of draws ``(n, ...)``."""
    tail = 50 * (1 - CONFIDENCE)
    ends: npt.NDArray[np.float64] = np.percentile(np.asarray(draws), (tail, 100 - tail), axis=0)
    return ends


def _resampled_means(strata: Sequence[Sequence[float]], count: int) -> npt.NDArray[np.float64]:
    generator = np.random.default_rng(0)
    means = np.zeros(DRAWS)
    for stratum in strata:
        drawn = generator.choice(np.array(stratum, float), (DRAWS, len(stratum) - 1))
        means += drawn.mean(axis=1) * (len(stratum) / count)
    return means
