"""Means over races, with bootstrap intervals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

#: Coverage probability of all intervals that stkzoo reports.
CONFIDENCE = 0.95
_DRAWS = 2000


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


def estimate_mean(
    values: Sequence[float | None],
    strata: Sequence[Hashable],
    bounds: tuple[float, float] | None = None,
) -> Estimate | None:
    """Returns the mean of one value per race, with a 95 % bootstrap interval.

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
    if bounds is not None and all(min(own) == max(own) for own in members.values()):
        margin = 1 - ((1 - CONFIDENCE) / 2) ** (1 / count)
        return Estimate(mean, max(bounds[0], mean - margin), min(bounds[1], mean + margin))
    low, high = percentile_interval(_resampled_means(list(members.values()), count))
    # If all races agree, sums in different orders can differ in the last digit.
    return Estimate(mean, min(float(low), mean), max(float(high), mean))


def percentile_interval(draws: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Returns both ends ``(2, ...)`` of the central 95 % interval of draws ``(n, ...)``."""
    tail = 50 * (1 - CONFIDENCE)
    ends: npt.NDArray[np.float64] = np.percentile(np.asarray(draws), (tail, 100 - tail), axis=0)
    return ends


def _resampled_means(strata: Sequence[Sequence[float]], count: int) -> npt.NDArray[np.float64]:
    generator = np.random.default_rng(0)
    means = np.zeros(_DRAWS)
    for stratum in strata:
        drawn = generator.choice(np.array(stratum, float), (_DRAWS, len(stratum) - 1))
        means += drawn.mean(axis=1) * (len(stratum) / count)
    return means
