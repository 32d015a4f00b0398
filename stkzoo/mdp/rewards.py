"""Rewards as sums of named terms, each computed for all karts at once.

A *term* is a function from a :class:`~stkzoo.mdp.transition.Transition` to ``(K,)`` floats.
A :class:`Reward` weighs and sums terms; their weighted values are in
``infos[agent]["reward/<name>"]``.

Write ``reward="placement"`` to choose a shipped reward, ``reward={"time": 5.0}`` to
reweigh terms of the default one, ``reward={"drift": my_term}`` to add a term of your own,
``reward={"place": 0}`` to drop one, a :class:`Reward` to start from nothing, and a mapping
from agents to any of these to give agents rewards of their own. The default is ``"race"``,
and ``"reference"`` for the Gymnasium ids of pystk2-gymnasium.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.errors import ConfigError, unknown_name
from stkzoo.mdp.transition import Transition

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
RewardTerm = Callable[[Transition], FloatArray]


def progress(step: Transition) -> FloatArray:
    """A tenth of the metres driven."""
    return np.asarray((step.distance - step.distance_before) / 10.0, np.float64)


def rank(step: Transition) -> FloatArray:
    """(1 - position/K) (3 + 7 f), f being 1 on the finishing step and 0 before."""
    return (1.0 - step.position / step.num_kart) * (3.0 + 7.0 * step.finishes)


def time(step: Transition) -> FloatArray:
    """A constant price of every step, -0.1."""
    return np.full(step.num_kart, -0.1)


def finish(step: Transition) -> FloatArray:
    """10 on the finishing step."""
    return np.where(step.finishes, 10.0, 0.0)


def course(step: Transition) -> FloatArray:
    """The share of the race driven in this step; sums to 1 for a kart that finishes."""
    done = _driven(step.after, step.distance, step.race_length)
    return (done - np.minimum(step.distance_before, step.race_length)) / step.race_length


def _driven(moment: Snapshot, distance: FloatArray, race_length: float) -> FloatArray:
    """Metres of the race driven, ``(K,)``, at most its length."""
    # The engine may finish a kart a few centimetres before the line.
    has_finished = moment.karts["has_finished_race"] > 0
    return np.where(has_finished, race_length, np.minimum(distance, race_length))


def placement(step: Transition) -> FloatArray:
    """On the finishing step, 1 for the winner down to 0 for the last, evenly spaced."""
    others = max(step.num_kart - 1, 1)
    return step.finishes * (step.num_kart - step.position) / others


def advance(step: Transition) -> FloatArray:
    """A tenth of the metres of the race driven, which end at the finish line."""
    return (
        _driven(step.after, step.distance, step.race_length)
        - _driven(step.before, step.distance_before, step.race_length)
    ) / 10.0


def place(step: Transition) -> FloatArray:
    """The change of 20 (K - position)/(K - 1) times the share of the race driven.

    It is a potential: over an episode it sums to 20 for the winner, down to 0 for the last,
    wherever the karts started. A place won early counts little until the kart has driven on.
    """

    def potential(moment: Snapshot, distance: FloatArray) -> FloatArray:
        share = _driven(moment, distance, step.race_length) / step.race_length
        ahead_of = (step.num_kart - moment.karts["position"]) / max(step.num_kart - 1, 1)
        return np.asarray(20.0 * ahead_of * share, np.float64)

    return potential(step.after, step.distance) - potential(step.before, step.distance_before)


#: The terms that the kernel's ``StepScorer`` knows, by its numbers for them.
KERNEL_TERMS: tuple[RewardTerm, ...] = (
    progress,
    rank,
    time,
    finish,
    course,
    placement,
    advance,
    place,
)


@dataclass(frozen=True)
class Reward:
    """A weighted sum of named terms.

    Attributes:
        terms: the terms by name.
        weights: weights by name; 1 where none is given.
    """

    terms: Mapping[str, RewardTerm]
    weights: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, term in self.terms.items():
            if not callable(term):
                raise ConfigError(
                    f"reward term {name!r} is {term!r}, expected a function of a Transition "
                    "that returns (K,) floats"
                )
        for name, weight in self.weights.items():
            if name not in self.terms:
                raise unknown_name("reward term", name, self.terms)
            if not np.isfinite(weight):
                raise ConfigError(f"weight of reward term {name!r} is {weight!r}, not finite")

    def __call__(self, step: Transition) -> dict[str, FloatArray]:
        """The weighted value of each term, ``(K,)`` float64 by name."""
        values = {}
        for name, term in self.terms.items():
            try:
                value = np.asarray(term(step), np.float64)
            except Exception as error:
                raise ConfigError(
                    f"reward term {name!r} failed: {type(error).__name__}: {error}"
                ) from error
            if value.shape != (step.num_kart,) or not np.isfinite(value).all():
                raise ConfigError(
                    f"reward term {name!r} returned {value!r}, expected {step.num_kart} finite "
                    "numbers, one a kart"
                )
            values[name] = value * self.weights[name] if name in self.weights else value
        return values

    @cached_property
    def kernel_terms(self) -> tuple[IntArray, FloatArray] | None:
        """The kernel's numbers of the terms, and their weights.

        ``None`` if a term is not one of this module's.
        """
        if not all(term in KERNEL_TERMS for term in self.terms.values()):
            return None
        numbers = [KERNEL_TERMS.index(term) for term in self.terms.values()]
        weights = [self.weights.get(name, 1.0) for name in self.terms]
        return np.array(numbers, np.intp), np.array(weights, np.float64)

    def adapted(self, changes: Mapping[str, float | RewardTerm]) -> Reward:
        """This reward with other weights (numbers) and further or other terms (functions)."""
        terms, weights = dict(self.terms), dict(self.weights)
        for name, change in changes.items():
            if callable(change):
                terms[name] = change
            elif isinstance(change, (int, float)):
                weights[name] = float(change)
            else:
                raise ConfigError(
                    f"reward term {name!r} is {change!r}, expected a weight or a function"
                )
        return Reward(terms, weights)


#: The shipped rewards. ``race`` is the default: a better drive earns more. A finisher
#: gets L/10 + 20 (K - p)/(K - 1) + 10 - 0.02 N for a race of L metres that it finishes in place p
#: of K, after N steps; a kart that stands still gets -0.02 N.
#: ``reference`` is the formula of pystk2-gymnasium, which also pays a kart that stands still.
#: ``placement`` gives a total in [0, 2], the higher the better the place.
REWARDS: Mapping[str, Reward] = {
    "race": Reward(
        {"advance": advance, "place": place, "finish": finish, "time": time}, {"time": 0.2}
    ),
    "reference": Reward({"progress": progress, "rank": rank, "time": time, "finish": finish}),
    "placement": Reward({"course": course, "placement": placement}),
}


@dataclass(frozen=True)
class RewardOver:
    """A user's choice of reward where the default is not ``"race"``.

    Attributes:
        default: name of the reward that ``None`` stands for and that mappings adapt.
        choice: the user's.
    """

    default: str
    choice: object = None


def as_reward(choice: object, default: str = "race") -> Reward:
    """The reward that a user's choice stands for (see the module's text)."""
    if choice is None:
        return REWARDS[default]
    if isinstance(choice, Reward):
        return choice
    if isinstance(choice, str):
        if choice not in REWARDS:
            raise unknown_name("reward", choice, REWARDS)
        return REWARDS[choice]
    if isinstance(choice, Mapping):
        return REWARDS[default].adapted(choice)
    raise ConfigError(
        f"reward is {choice!r}, expected one of {', '.join(REWARDS)}, a mapping from terms to "
        "weights or functions, a Reward, or a mapping from agents to these"
    )
