"""The opponent pool of self-play: frozen snapshots and game bots, drawn by difficulty.

Prioritized fictitious self-play (Vinyals et al., "Grandmaster level in StarCraft II using
multi-agent reinforcement learning", 2019) draws an opponent that is beaten with probability p with
weight (1 - p)^2. This avoids forgetting and spends little time on opponents that the learner beats
anyway. Here, the weight is (1 - p)^2 + 0.02, so that every opponent can be drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from stkzoo._schema import Count, Share

#: Weight of one race in the win rate against an opponent.
_RATE = 0.1
#: Added to each weight, so that every opponent can be drawn.
_LEAST_WEIGHT = 0.02


def bot_name(difficulty: int) -> str:
    """Returns the opponent name of the game's bots at a difficulty, 0 to 3."""
    return f"bot:{difficulty}"


@dataclass(slots=True)
class Rival:
    """An opponent in the pool.

    Attributes:
        name: file name of a snapshot, or ``bot:0`` to ``bot:3``.
        beaten: fraction of duels that the learner won, 0 to 1; recent races weigh more.
        races: number of races.
    """

    name: str
    beaten: Share = 0.5
    races: Count = 0

    def update(self, beaten: float) -> None:
        """Adds the fraction of duels that the learner won in a race."""
        # The first races form a plain mean, which starts at one half.
        share = max(_RATE, 1.0 / (self.races + 2))
        self.beaten += share * (beaten - self.beaten)
        self.races += 1


class RivalPool:
    """A pool of opponents.

    Args:
        size: capacity; when full, a new opponent replaces the most beaten one.
        names: initial opponents.
    """

    def __init__(self, size: int, names: Sequence[str] = ()) -> None:
        self.size = size
        self._opponents = {name: Rival(name) for name in names}

    @property
    def opponents(self) -> list[Rival]:
        """All opponents, the oldest first."""
        return list(self._opponents.values())

    def add(self, name: str) -> None:
        """Adds an opponent; when full, it replaces the most beaten one."""
        if name not in self._opponents and len(self._opponents) >= self.size:
            del self._opponents[max(self.opponents, key=lambda opponent: opponent.beaten).name]
        self._opponents.setdefault(name, Rival(name))

    def draw(self, random: np.random.Generator, among: Sequence[str] | None = None) -> str:
        """Draws an opponent's name by weight.

        Args:
            random: random generator.
            among: names in the pool to draw from; ``None`` for all.
        """
        odds = self.odds(among)
        return list(odds)[int(random.choice(len(odds), p=list(odds.values())))]

    def odds(self, among: Sequence[str] | None = None) -> dict[str, float]:
        """Returns the probability with which :meth:`draw` draws each opponent.

        Args:
            among: names in the pool to draw from; ``None`` for all.
        """
        names = list(self._opponents) if among is None else list(among)
        shares = [(1.0 - self._opponents[name].beaten) ** 2 for name in names]
        weights = np.array(shares) + _LEAST_WEIGHT
        return dict(zip(names, (weights / weights.sum()).tolist(), strict=True))

    def update(self, name: str, beaten: float) -> None:
        """Updates an opponent after a race; ignores opponents no longer in the pool."""
        if name in self._opponents:
            self._opponents[name].update(beaten)

    def state(self) -> list[dict[str, Any]]:
        """Returns the pool as JSON values."""
        return [asdict(opponent) for opponent in self.opponents]

    def restore(self, rivals: Sequence[Rival]) -> None:
        """Restores a :meth:`state`.

        Raises:
            msgspec.ValidationError: the state is damaged.
        """
        self._opponents = {rival.name: replace(rival) for rival in rivals}
