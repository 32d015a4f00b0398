"""Opponents of a race, and pools from which they are drawn."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stkzoo._checks import check_arguments, check_number, shortened
from stkzoo.drivers.driver import Driver, find_driver, frozen_policy
from stkzoo.errors import ConfigError


def as_driver(opponent: object) -> Driver:
    """Converts an opponent to a driver.

    Args:
        opponent: a driver, a driver's name (:func:`~stkzoo.race.find_driver`), or a policy
            (:meth:`Driver.of_policy`).

    Raises:
        ConfigError: the opponent is none of these, or no driver has this name.
    """
    if isinstance(opponent, str):
        opponent = find_driver(opponent)
    if isinstance(opponent, Driver):
        return opponent
    if callable(opponent) or hasattr(opponent, "predict"):
        return Driver.of_policy(opponent)
    raise ConfigError(
        f"an opponent is {shortened(opponent, 200)}, expected a driver's name such as "
        "'pretrained:ace' or 'ai:3', a Driver, a function from an observation to an action, or "
        "an object with Stable-Baselines3's predict"
    )


#: Opponents in errors, by whether they are the game's AI.
_KINDS = {None: "", True: " of the game's AI", False: " besides the game's AI"}


@check_arguments
class OpponentPool:
    """A pool of weighted opponents. A race draws one for each kart that the pool drives.

    You may add opponents while races run. Each race draws from the opponents that are in the pool
    when the race starts.

    Attributes:
        weights: relative frequency of each opponent, by name. You may change it; an opponent with
            weight 0 is never drawn.

    Args:
        opponents: initial opponents, see :meth:`add`; or a mapping from driver names to weights.
        weights: one weight per opponent; by default, the values of a mapping, or 1 each.

    Raises:
        ConfigError: see :meth:`add`; or the number of weights is wrong.

    Example:
        >>> from stkzoo import OpponentPool
        >>> pool = OpponentPool(["pretrained:ace", "ai:3"], weights=[1, 3])
        >>> driver = pool.add("heuristic", weight=2)
        >>> pool.weights
        {'pretrained:ace': 1.0, 'ai:3': 3.0, 'heuristic': 2.0}
    """

    def __init__(
        self,
        opponents: Iterable[Any] | Mapping[str, float] = (),
        weights: Sequence[float] | None = None,
    ) -> None:
        self._drivers: dict[str, Driver] = {}
        self.weights: dict[str, float] = {}
        if isinstance(opponents, str):
            raise ConfigError(
                f"opponents is {opponents!r}, expected a list such as [{opponents!r}]"
            )
        if isinstance(opponents, Mapping) and weights is None:
            weights = list(opponents.values())
        entries = list(opponents)
        chosen = [1.0] * len(entries) if weights is None else list(weights)
        if len(chosen) != len(entries):
            raise ConfigError(
                f"{len(chosen)} weights for {len(entries)} opponents; give one for each"
            )
        for opponent, weight in zip(entries, chosen, strict=True):
            self.add(opponent, weight=weight)

    def add(
        self, opponent: Any, *, weight: float = 1.0, view: str | None = None, name: str = ""
    ) -> Driver:
        """Adds an opponent.

        Args:
            opponent: a driver's name, a :class:`~stkzoo.race.Driver`, or a policy
                (:meth:`~stkzoo.race.Driver.of_policy`). The pool copies a policy, so later learning
                does not change the opponent.
            weight: relative frequency of the opponent.
            view: view of a policy; by default, the view of the agents.
            name: display name; if it is taken, a number is appended.

        Returns:
            The opponent as a driver, which you can also pass to :func:`~stkzoo.race.run_race`.

        Raises:
            ConfigError: the opponent is invalid, or the weight is not above 0.
        """
        weight = check_number("weight of an opponent", weight)
        if isinstance(opponent, (str, Driver)):
            driver = as_driver(opponent)
            name = name or driver.name or driver.source
        else:
            driver = Driver.of_policy(frozen_policy(opponent), view, name)
            name = driver.name
        numbered = (f"{name} {number}" for number in itertools.count(2))
        name = next(free for free in itertools.chain([name], numbered) if free not in self.weights)
        self._drivers[name] = replace(driver, name=name)
        self.weights[name] = weight
        return self._drivers[name]

    def __len__(self) -> int:
        return len(self._drivers)

    def draw(
        self,
        random: np.random.Generator,
        difficulty: int | None = None,
        is_game_ai: bool | None = None,
    ) -> Driver:
        """Draws an opponent by weight.

        Args:
            random: random generator.
            difficulty: difficulty of the race, which excludes opponents that require another one;
                ``None`` if it is not decided.
            is_game_ai: whether the opponent is the game's AI; ``None`` for both kinds.

        Raises:
            ConfigError: a weight is invalid, missing or of no opponent, or no opponent has a
                weight above 0.
        """
        if self.weights.keys() != self._drivers.keys():
            raise ConfigError(
                f"the pool has weights of {', '.join(self.weights) or 'none'}, expected "
                f"{', '.join(self._drivers) or 'none'}; add() adds an opponent, and weight 0 means "
                "never"
            )
        weights = {
            name: check_number(f"weight of opponent {name!r}", self.weights[name], 0, 1e12)
            for name, driver in self._drivers.items()
            if (difficulty is None or driver.difficulty in (None, difficulty))
            and is_game_ai in (None, driver.is_game_ai)
        }
        if not sum(weights.values()):
            which = "" if difficulty is None else f" at difficulty {difficulty}"
            noun = _KINDS[is_game_ai]
            raise ConfigError(f"the pool has no opponents{which}{noun}; add() one before the race")
        shares = np.array(list(weights.values())) / sum(weights.values())
        return self._drivers[list(weights)[int(random.choice(len(shares), p=shares))]]
