"""Ratings of agents from the finishing orders of their races.

The model is Plackett-Luce, from the library openskill. The probability that an agent finishes
first is its strength divided by the sum of the strengths of all agents in the race. The same rule
determines second place among the remaining agents, and so on.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from stkzoo._imports import import_extra
from stkzoo.evaluation.statistics import Estimate, percentile_interval

#: Number of random orders of the races over which ratings are averaged. The model updates ratings
#: race by race, so they depend on the order.
_ORDERS = 30
#: Maximum and minimum number of bootstrap draws for the interval, and the total number of rated
#: races that limits it.
_MAX_DRAWS, _MIN_DRAWS, _MAX_RATED_RACES = 400, 100, 100_000
#: Numbers of the agents in a race, best first, and their places.
PlacedAgents = tuple[Sequence[int], Sequence[int]]


@dataclass(frozen=True, slots=True)
class Rating(Estimate):
    """The rating of an agent; 25 is the prior mean.

    The value is the model's rating, averaged over random orders of the races.

    Attributes:
        low: lower end of the interval.
        high: upper end of the interval.
        sigma: standard deviation according to the model.
    """

    low: float
    high: float
    sigma: Annotated[float, Meta(ge=0)]


def require_openskill() -> Any:
    """Imports ``openskill.models``.

    Raises:
        ConfigError: openskill is not installed.
    """
    return import_extra("openskill.models", "ratings need", "races")


def rate(
    races: Sequence[Sequence[int]],
    num_agents: int,
    seed: int = 0,
    places: Sequence[Sequence[int]] | None = None,
) -> list[Rating]:
    """Returns the ratings of all agents.

    The interval comes from a bootstrap over races. The resampled pool includes one additional race
    of all agents in random order, so that outcomes that have not occurred keep some probability.
    Each draw has one order of the races, while the value averages several, so the interval also
    contains the effect of the order.

    Args:
        races: numbers of the agents in each race, best first. A race of one agent rates nobody.
        num_agents: number of agents; their numbers start at 0.
        seed: seed of the bootstrap and the orders. The same arguments return the same ratings.
        places: places of these agents; equal places are ties. ``None`` if there are no ties.

    Raises:
        ConfigError: openskill is not installed.
    """
    model = require_openskill().PlackettLuce(tau=0)  # tau=0: agents do not change over time
    generator = random.Random(seed)
    if places is None:
        places = [range(len(order)) for order in races]
    placed = list(zip(races, places, strict=True))
    passes = [
        _pass(model, generator.sample(placed, len(placed)), num_agents) for _ in range(_ORDERS)
    ]
    num_draws = max(_MIN_DRAWS, min(_MAX_DRAWS, _MAX_RATED_RACES // max(len(placed), 1)))
    draws = [
        _pass(model, _resample(placed, num_agents, generator), num_agents) for _ in range(num_draws)
    ]
    values, sigmas = np.mean(np.array(passes), axis=0).T.tolist()
    lows, highs = percentile_interval(np.array(draws)[:, :, 0]).tolist()
    return [
        Rating(value, min(low, value), max(high, value), sigma)
        for value, low, high, sigma in zip(values, lows, highs, sigmas, strict=True)
    ]


def _resample(
    races: Sequence[PlacedAgents], num_agents: int, generator: random.Random
) -> list[PlacedAgents]:
    """Returns a bootstrap sample of the races and of one additional race in random order."""
    agents = range(num_agents)
    numbers = generator.choices(range(len(races) + 1), k=len(races) + 1)
    return [
        races[n] if n < len(races) else (generator.sample(agents, num_agents), agents)
        for n in numbers
    ]


def _pass(model: Any, races: Sequence[PlacedAgents], num_agents: int) -> list[tuple[float, float]]:
    """Returns the rating and standard deviation of every agent after a sequence of races."""
    ratings = [model.rating() for _ in range(num_agents)]
    for order, places in races:
        if len(order) < 2:  # the model refuses it
            continue
        after = model.rate([[ratings[agent]] for agent in order], ranks=list(places))
        for agent, (rating,) in zip(order, after, strict=True):
            ratings[agent] = rating
    return [(rating.mu, rating.sigma) for rating in ratings]
