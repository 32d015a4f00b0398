"""Ratings of agents from the finishing orders of their races.

The model is Plackett-Luce, from the library openskill: the probability that an agent finishes
first is its share of the strengths of all agents in the race; the same then holds for second
place among the others, and so on.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from stkzoo._schema import Within
from stkzoo.errors import import_extra
from stkzoo.evaluation.statistics import Estimate, percentile_interval

#: The model updates race by race, so a rating is the mean over this many orders of the races.
_ORDERS = 30
#: Bootstrap draws for the interval; fewer when there are many races.
_MAX_DRAWS, _MIN_DRAWS, _MAX_RATED_RACES = 400, 100, 100_000


@dataclass(frozen=True, slots=True)
class Rating(Estimate):
    """The strength of an agent; 25 is the prior mean.

    The value is the model's rating, averaged over orders of the races.

    Attributes:
        sigma: the model's own standard deviation.
    """

    sigma: Annotated[float, Within(0)]


def require_openskill() -> Any:
    """Imports ``openskill.models``.

    Raises:
        ConfigError: openskill is not installed.
    """
    return import_extra("openskill.models", "ratings need", "tournament")


def rate(races: Sequence[Sequence[int]], num_agents: int, seed: int = 0) -> list[Rating]:
    """Rates agents.

    The interval is a bootstrap over races. One more race with all agents in random order is part
    of the resampled pool, so that an outcome that has not occurred yet keeps some probability.

    Args:
        races: the agents of each race, best first.
        num_agents: the number of agents; they are numbered from 0.
        seed: the same arguments give the same ratings.

    Raises:
        ConfigError: openskill is not installed.
    """
    model = require_openskill().PlackettLuce(tau=0)  # tau: agents do not change meanwhile
    generator = random.Random(seed)
    passes = [_pass(model, generator.sample(races, len(races)), num_agents) for _ in range(_ORDERS)]
    num_draws = max(_MIN_DRAWS, min(_MAX_DRAWS, _MAX_RATED_RACES // max(len(races), 1)))
    draws = [
        _pass(model, _resample(races, num_agents, generator), num_agents) for _ in range(num_draws)
    ]
    values, sigmas = np.mean(np.array(passes), axis=0).T.tolist()
    lows, highs = percentile_interval(np.array(draws)[:, :, 0]).tolist()
    return [
        Rating(value, min(low, value), max(high, value), sigma)
        for value, low, high, sigma in zip(values, lows, highs, sigmas, strict=True)
    ]


def _resample(
    races: Sequence[Sequence[int]], num_agents: int, generator: random.Random
) -> list[Sequence[int]]:
    """A bootstrap sample of the races and one more in random order."""
    agents = range(num_agents)
    numbers = generator.choices(range(len(races) + 1), k=len(races) + 1)
    return [races[n] if n < len(races) else generator.sample(agents, num_agents) for n in numbers]


def _pass(model: Any, races: Sequence[Sequence[int]], num_agents: int) -> list[tuple[float, float]]:
    """Mean and deviation of every agent after some races, one after another."""
    ratings = [model.rating() for _ in range(num_agents)]
    for order in races:
        after = model.rate([[ratings[agent]] for agent in order], ranks=list(range(len(order))))
        for agent, (rating,) in zip(order, after, strict=True):
            ratings[agent] = rating
    return [(rating.mu, rating.sigma) for rating in ratings]
