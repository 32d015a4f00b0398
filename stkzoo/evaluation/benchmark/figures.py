"""Means of races, and how sure they are."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["CONFIDENCE", "Estimate", "estimate"]

CONFIDENCE = 0.95
_DRAWS = 2000


@dataclass(frozen=True, slots=True)
class Estimate:
    """A mean with an interval.

    Attributes:
        value: the mean over races.
        low: where the interval begins; ``None`` if the races do not say.
        high: where it ends.
    """

    value: float
    low: float | None
    high: float | None


def estimate(
    values: Sequence[float],
    strata: Sequence[Hashable],
    bounds: tuple[float, float] | None = None,
) -> Estimate:
    """The mean of one value a race, with a 95 % interval by bootstrap.

    Races are drawn anew, with repeats, among those of one stratum, one race less than there are:
    this way the drawn means vary as much as the mean itself does, also where a stratum has
    few races (McCarthy and Snowden 1985).

    Args:
        values: one a race, at least one.
        strata: what each race has in common with others; the same in all repetitions of
            the experiment. A stratum with a single race says nothing about chance, and then
            there is no interval.
        bounds: the least and greatest possible value, for shares and counts. If all races of
            each stratum agree, the bootstrap sees no doubt at all. The interval is then as wide
            as that of an event which did not happen in so many tries: up to
            ``1 - 0.025 ** (1 / tries)``.
    """
    members: dict[Hashable, list[float]] = {}
    for value, stratum in zip(values, strata, strict=True):
        members.setdefault(stratum, []).append(value)
    mean = math.fsum(values) / len(values)
    if min(map(len, members.values())) < 2:
        return Estimate(mean, None, None)
    if bounds is not None and all(min(own) == max(own) for own in members.values()):
        doubt = 1 - ((1 - CONFIDENCE) / 2) ** (1 / len(values))
        return Estimate(mean, max(bounds[0], mean - doubt), min(bounds[1], mean + doubt))
    low, high = _interval(list(members.values()), len(values))
    # Where all races agree, sums in another order differ in the last place.
    return Estimate(mean, min(low, mean), max(high, mean))


def _interval(strata: Sequence[Sequence[float]], count: int) -> tuple[float, float]:
    chance = np.random.default_rng(0)
    means = np.zeros(_DRAWS)
    for stratum in strata:
        drawn = chance.choice(np.array(stratum, float), (_DRAWS, len(stratum) - 1))
        means += drawn.mean(axis=1) * (len(stratum) / count)
    outside = 100 * (1 - CONFIDENCE) / 2
    low, high = np.percentile(means, (outside, 100 - outside))
    return float(low), float(high)
