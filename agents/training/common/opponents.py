"""The opponent pool of self-play: frozen snapshots and the game's bots, the hard ones more often.

Prioritised fictitious self-play (Vinyals et al., "Grandmaster level in StarCraft II using
multi-agent reinforcement learning", 2019): an opponent that is beaten with probability p is drawn
with weight (1 - p)^2, so that nothing is forgotten and little time goes to what is won anyway.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from stkzoo._schema import Count, Share, typed

#: Weight of one race in an opponent's share of wins.
_RATE = 0.1
#: Keeps every opponent in the draw.
_LEAST_WEIGHT = 0.02


def bot_name(difficulty: int) -> str:
    """The name of the game's bots of a difficulty, 0 to 3, as opponents."""
    return f"bot:{difficulty}"


@dataclass(slots=True)
class Rival:
    """An opponent in the pool.

    Attributes:
        name: a snapshot's file name, or ``bot:0`` to ``bot:3``.
        beaten: the learner's share of duels won, 0 to 1; recent races count most.
        races: how many races there were.
    """

    name: str
    beaten: Share = 0.5
    races: Count = 0

    def update(self, beaten: float) -> None:
        """Updates with the share of the duels that the learner won in a race."""
        # The first races are a plain mean, with one half at the start.
        share = max(_RATE, 1.0 / (self.races + 2))
        self.beaten += share * (beaten - self.beaten)
        self.races += 1


class RivalPool:
    """The opponents.

    Args:
        size: capacity; a full pool drops the most beaten opponent for a new one.
        names: the first opponents.
    """

    def __init__(self, size: int, names: Sequence[str] = ()) -> None:
        self.size = size
        self._opponents = {name: Rival(name) for name in names}

    @property
    def opponents(self) -> list[Rival]:
        """All of them, the oldest first."""
        return list(self._opponents.values())

    def add(self, name: str) -> None:
        """Adds an opponent; a full pool drops the most beaten one for it."""
        if name not in self._opponents and len(self._opponents) >= self.size:
            del self._opponents[max(self.opponents, key=lambda opponent: opponent.beaten).name]
        self._opponents.setdefault(name, Rival(name))

    def draw(self, random: np.random.Generator, among: Sequence[str] | None = None) -> str:
        """Draws an opponent's name by weight.

        Args:
            random: draws it.
            among: only these, which must be in the pool; all by default.
        """
        names = list(self._opponents) if among is None else list(among)
        shares = [(1.0 - self._opponents[name].beaten) ** 2 for name in names]
        weights = np.array(shares) + _LEAST_WEIGHT
        return names[int(random.choice(len(names), p=weights / weights.sum()))]

    def update(self, name: str, beaten: float) -> None:
        """Updates an opponent after a race; one that was dropped is ignored."""
        if name in self._opponents:
            self._opponents[name].update(beaten)

    def state(self) -> list[dict[str, Any]]:
        """All of it as JSON values."""
        return [asdict(opponent) for opponent in self.opponents]

    def restore(self, state: Sequence[Mapping[str, Any]]) -> None:
        """Restores a :meth:`state`.

        Raises:
            Unreadable: it is damaged.
        """
        rivals = typed(tuple[Rival, ...], [dict(kept) for kept in state])
        self._opponents = {rival.name: rival for rival in rivals}
