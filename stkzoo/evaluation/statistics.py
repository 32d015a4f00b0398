"""Means over races with bootstrap intervals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

#: Coverage of every interval that stkzoo reports.
CONFIDENCE = 0.95
_DRAWS = 2000


@dataclass(frozen=True, slots=True)
class Estimate:
    """A mean with an interval.

    Attributes:
        value: the mean over races.
        low: lower end of the interval; ``None`` if the races do not determine one.
        high: upper end of the interval; ``None`` likewise.
    """

    value: float
    low: float | None
    high: float | None

    @property
    def interval(self) -> tuple[float, float]:
        """Both ends; the value itself where there is no interval."""
        if self.low is None or self.high is None:
            return self.value, self.value
        return self.low, self.high


def estimate_mean(
    values: Sequence[float | None],
    strata: Sequence[Hashable],
    bounds: tuple[float, float] | None = None,
) -> Estimate | None:
    """The mean of one value per race, with a 95 % bootstrap interval.

    The bootstrap resamples the races within each stratum, and draws one race less than the
    stratum has. The drawn means then vary as much as the mean itself does, even in small strata
    (McCarthy and Snowden 1985). ``None`` if no value is known.

    Args:
        values: one per race; ``None`` where there is none.
        strata: the stratum of each race, fixed over repetitions of the experiment. A stratum
            with a single race carries no information about chance; the result then has no
            interval.
        bounds: the least and greatest possible value, for shares and counts. If all races of
            each stratum agree, the bootstrap has no spread. The interval is then that of an
            event that did not happen in so many tries: up to ``1 - 0.025 ** (1 / tries)``.
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
    # Where all races agree, sums in another order differ in the last place.
    return Estimate(mean, min(float(low), mean), max(float(high), mean))


def percentile_interval(draws: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Lower and upper end ``(2, ...)`` of the central interval of draws ``(n, ...)``."""
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
