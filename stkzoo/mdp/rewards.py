"""Rewards as sums of named terms, each computed for all karts at once.

The kernel computes the built-in *terms* (``stkzoo/kernel/step_scorer.c``). Any other term is a
function from a :class:`~stkzoo.mdp.transition.Transition` to ``(K,)`` float64. A :class:`Reward` is
a weighted sum of terms; ``infos[agent]["reward/<name>"]`` holds the weighted value of each term.

The ``reward`` argument of an environment accepts:

- a name of a built-in reward, such as ``"placement"``;
- a mapping that changes the default reward: ``{"time": 5.0}`` changes a weight, ``{"place": 0}``
  removes a term, and ``{"drift": my_term}`` adds your own term;
- a :class:`Reward` that you define from scratch;
- a mapping from agents to any of these.

The default is ``"race"``; the Gymnasium ids of pystk2-gymnasium default to ``"reference"``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._checks import check_name, check_number, check_type, shortened
from stkzoo.errors import ConfigError, StkzooError
from stkzoo.mdp.transition import Transition

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class KernelTerm:
    """A built-in term, computed by the kernel: ``stkzoo/kernel/step_scorer.c`` has the formula.

    Attributes:
        name: name of the term. The function in C is ``<name>_term``.
    """

    name: str


RewardTerm = KernelTerm | Callable[[Transition], FloatArray]

#: 0.1 per meter driven.
progress = KernelTerm("progress")
#: (1 - position/K) (3 + 7 f), where f is 1 in the finishing step and otherwise 0.
rank = KernelTerm("rank")
#: -0.1 in every step, a time penalty.
time = KernelTerm("time")
#: 10 in the finishing step.
finish = KernelTerm("finish")
#: The fraction of the race driven in this step; a finisher's sum is 1.
course = KernelTerm("course")
#: In the finishing step, 1 for the winner down to 0 for the last kart, evenly spaced.
placement = KernelTerm("placement")
#: 0.1 per meter driven up to the finish line.
advance = KernelTerm("advance")
#: The change of 20 (K - position)/(K - 1) times the fraction of the race driven. Over a whole race,
#: it sums to 20 for the winner and 0 for the last kart, from every place on the grid.
place = KernelTerm("place")
#: 1 for each place gained, -1 for each place lost.
overtaking = KernelTerm("overtaking")


@dataclass(frozen=True)
class Reward:
    """A weighted sum of named terms.

    Attributes:
        terms: terms by name.
        weights: weights by name; the default weight is 1.
        limits: the most that a term pays per second of game time, before its weight, by name. What
            is left is paid in later steps, at a tenth of the limit; the finishing step pays all.
            Off the road, the game's distance can jump by up to a lap for a few steps; with a limit,
            such a jump pays little.

    Raises:
        ConfigError: a name is not text, a term is neither built in nor callable, or a weight or
            limit is not finite or has no term.
    """

    terms: Mapping[str, RewardTerm]
    weights: Mapping[str, float] = field(default_factory=dict)
    limits: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for part in ("terms", "weights", "limits"):
            check_type(part, getattr(self, part), Mapping, "a dict by name")
        for name, term in self.terms.items():
            if not isinstance(name, str) or not _is_term(term):
                raise ConfigError(
                    f"reward term {name!r} is {term!r}, expected a name and a function of a "
                    "Transition that returns (K,) floats"
                )
        for name, weight in self.weights.items():
            check_name("reward term", name, self.terms)
            if not isinstance(weight, Real) or not np.isfinite(float(weight)):
                raise ConfigError(
                    f"weight of reward term {name!r} is {weight!r}, expected a finite number, or a "
                    "function to define the term"
                )
        for name, limit in self.limits.items():
            check_name("reward term", name, self.terms)
            check_number(f"limit of reward term {name!r}", limit)

    def value(self, name: str, step: Transition) -> FloatArray:
        """Returns the weighted value of your own term before its limit, ``(K,)`` float64.

        Raises:
            ConfigError: the term failed, or returned other values than K finite numbers.
        """
        term: Any = self.terms[name]
        try:
            returned = term(step)
            value = np.asarray(returned)
        except Exception as error:
            label = "" if isinstance(error, StkzooError) else f"{type(error).__name__}: "
            raise ConfigError(f"reward term {name!r} failed: {label}{error}") from error
        is_real, shape = value.dtype.kind in "biuf", (step.num_kart,)
        if value.shape != shape or not is_real or not np.isfinite(value).all():
            raise ConfigError(
                f"reward term {name!r} returned {shortened(returned)}, expected an array of shape "
                f"{shape}: a finite number for each kart"
            )
        return value.astype(np.float64) * self.weight_of(name)

    def weight_of(self, name: str) -> float:
        """Returns the weight of a term."""
        return float(self.weights.get(name, 1.0))

    def adapted(self, changes: Mapping[str, float | RewardTerm]) -> Reward:
        """Returns a copy with changed weights (numbers) and added or replaced terms (functions).

        A replaced term has no limit.

        Raises:
            ConfigError: a change is neither a number nor a function, or a weight has no term.
        """
        added = {name: change for name, change in changes.items() if _is_term(change)}
        weights = {name: weight for name, weight in changes.items() if name not in added}
        limits = {name: limit for name, limit in self.limits.items() if name not in added}
        return Reward({**self.terms, **added}, {**self.weights, **weights}, limits)  # type: ignore[dict-item]


def _is_term(value: object) -> bool:
    return isinstance(value, KernelTerm) or callable(value)


#: The built-in rewards. ``race`` is the default: driving better earns more. A kart that drives a
#: whole race of L meters and finishes in place p of K after N steps earns L/10 + 20 (K - p)/(K - 1)
#: + 10 - 0.02 N; a kart that stands still earns -0.02 N. Its limits are 50 m/s for ``advance``, and
#: 50 per second for ``place``.
#: ``reference`` is the formula of pystk2-gymnasium, which also rewards a kart that stands still.
#: ``placement`` has a return in [0, 2], which is higher for a better place.
REWARDS: Mapping[str, Reward] = {
    "race": Reward(
        {"advance": advance, "place": place, "finish": finish, "time": time},
        {"time": 0.2},
        {"advance": 5.0, "place": 50.0},
    ),
    "reference": Reward({"progress": progress, "rank": rank, "time": time, "finish": finish}),
    "placement": Reward({"course": course, "placement": placement}),
}


@dataclass(frozen=True)
class RewardOver:
    """A choice of reward for an environment whose default is not ``"race"``.

    Attributes:
        default: name of the reward that ``None`` selects and that mappings change.
        choice: the ``reward`` argument.
    """

    default: str
    choice: object = None


def as_reward(choice: object, default: str = "race") -> Reward:
    """Returns the reward for a ``reward`` argument (see the module's docstring).

    Args:
        choice: the argument.
        default: name of the reward that ``None`` selects and that mappings change.

    Raises:
        ConfigError: the choice is invalid.
    """
    if choice is None:
        return REWARDS[default]
    if isinstance(choice, Reward):
        return choice
    if isinstance(choice, str):
        check_name("reward", choice, REWARDS)
        return REWARDS[choice]
    if isinstance(choice, Mapping):
        return REWARDS[default].adapted(choice)
    raise ConfigError(
        f"reward is {shortened(choice, 40)}, expected one of {', '.join(REWARDS)}, a Reward, a "
        "dict of weights and functions such as {'time': 0.5, 'mine': function}, or a dict by agent"
    )
