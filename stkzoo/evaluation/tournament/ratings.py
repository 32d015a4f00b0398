"""How good agents are, from the orders in which they came in.

The model is Plackett-Luce, from the library openskill: an agent's chance to come in first is
its strength's share of the strengths of all in the race, then the same among the others.
"""

from __future__ import annotations

import importlib
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stkzoo.errors import ConfigError

__all__ = ["CONFIDENCE", "Rating", "rate", "rating_library"]

#: How often the interval has the rating that endless races would give.
CONFIDENCE = 0.95

#: Orders of the races that a rating is the mean of: the model takes one race after another.
_ORDERS = 30
#: Tournaments drawn anew from the races, for the interval; fewer when there are many races.
_MOST_DRAWS, _FEWEST_DRAWS, _MOST_RACES_RATED = 400, 100, 100_000


@dataclass(frozen=True, slots=True)
class Rating:
    """How good an agent is; 25 is the mean of all there could be.

    Attributes:
        value: the rating: the mean of the model's over the orders of the races.
        low: lower end of the interval.
        high: upper end of the interval.
        sigma: the model's own standard deviation.
    """

    value: float
    low: float
    high: float
    sigma: float


def rating_library() -> Any:
    """The library's models.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        return importlib.import_module("openskill.models")
    except ImportError as error:
        raise ConfigError(
            f"ratings need the library openskill ({error}); pip install 'stkzoo[tournament]'"
        ) from error


def rate(races: Sequence[Sequence[int]], num_agents: int, seed: int = 0) -> list[Rating]:
    """Rates agents.

    The interval is a bootstrap's: it says how far ratings would move had other races been
    drawn, whatever the model believes. To the races that are drawn from belongs one more,
    with all agents in an order by chance, so that what has not happened yet is not taken for
    impossible.

    Args:
        races: the agents of each race, best first.
        num_agents: how many agents; numbered from 0.
        seed: the same arguments give the same ratings.

    Raises:
        ConfigError: the library is not installed.
    """
    model = rating_library().PlackettLuce(tau=0)  # tau: agents do not change meanwhile
    chance = random.Random(seed)
    orders = [_pass(model, chance.sample(races, len(races)), num_agents) for _ in range(_ORDERS)]
    draws = max(_FEWEST_DRAWS, min(_MOST_DRAWS, _MOST_RACES_RATED // max(len(races), 1)))
    drawn = [_pass(model, _redrawn(races, num_agents, chance), num_agents) for _ in range(draws)]
    values, sigmas = np.mean(np.array(orders), axis=0).T.tolist()
    tail = 50 * (1 - CONFIDENCE)
    lows, highs = np.percentile(np.array(drawn)[:, :, 0], (tail, 100 - tail), axis=0).tolist()
    return [
        Rating(value, min(low, value), max(high, value), sigma)
        for value, low, high, sigma in zip(values, lows, highs, sigmas, strict=True)
    ]


def _redrawn(
    races: Sequence[Sequence[int]], num_agents: int, chance: random.Random
) -> list[Sequence[int]]:
    """As many races as there are and one, with repeats, of these and one by chance."""
    everybody = range(num_agents)
    numbers = chance.choices(range(len(races) + 1), k=len(races) + 1)
    return [races[n] if n < len(races) else chance.sample(everybody, num_agents) for n in numbers]


def _pass(model: Any, races: Sequence[Sequence[int]], num_agents: int) -> list[tuple[float, float]]:
    """Mean and deviation of every agent after some races, one after another."""
    ratings = [model.rating() for _ in range(num_agents)]
    for order in races:
        after = model.rate([[ratings[agent]] for agent in order], ranks=list(range(len(order))))
        for agent, (rating,) in zip(order, after, strict=True):
            ratings[agent] = rating
    return [(rating.mu, rating.sigma) for rating in ratings]
