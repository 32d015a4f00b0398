"""Rivals for self-play: frozen snapshots and the game's bots, the hard ones more often.

Prioritised fictitious self-play (Vinyals et al., "Grandmaster level in StarCraft II using
multi-agent reinforcement learning", 2019): a rival that is beaten with probability p comes with
weight (1 - p)^2, so that nothing is forgotten and little time goes to what is won anyway.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

__all__ = ["Pool", "Rival"]

#: How much one race counts in a rival's share of wins.
_MEMORY = 0.1
#: No rival is forgotten altogether.
_LEAST_WEIGHT = 0.02


@dataclass(slots=True)
class Rival:
    """One who was raced against.

    Attributes:
        name: a snapshot's file name, or ``bot:0`` to ``bot:3``.
        beaten: how often the learner is before it, from 0 to 1; recent races count most.
        races: how many there were.
    """

    name: str
    beaten: float = 0.5
    races: int = 0

    @property
    def weight(self) -> float:
        """How often it shall come, beside the others."""
        return (1.0 - self.beaten) ** 2 + _LEAST_WEIGHT

    def take_in(self, beaten: float) -> None:
        """Takes in a race: which share of the duels with it was won."""
        # The first races are a plain mean, with one half at the start.
        share = max(_MEMORY, 1.0 / (self.races + 2))
        self.beaten += share * (beaten - self.beaten)
        self.races += 1


class Pool:
    """The rivals.

    Args:
        size: how many are kept; beyond it the most beaten goes.
        rivals: those that there are.
    """

    def __init__(self, size: int, rivals: Sequence[Rival] = ()) -> None:
        self.size = size
        self._rivals = {rival.name: rival for rival in rivals}

    @property
    def rivals(self) -> list[Rival]:
        """All of them, the oldest first."""
        return list(self._rivals.values())

    def add(self, name: str) -> Rival | None:
        """Takes in a new rival.

        Returns:
            The one that had to go for it: the most beaten of those before.
        """
        gone = None
        if name not in self._rivals and len(self._rivals) >= self.size:
            gone = max(self.rivals, key=lambda rival: rival.beaten)
            del self._rivals[gone.name]
        self._rivals.setdefault(name, Rival(name))
        return gone

    def draw(self, random: np.random.Generator, among: Sequence[str] | None = None) -> str:
        """A rival's name, by its weight.

        Args:
            random: draws it.
            among: only these, which must be here; all by default.
        """
        names = list(self._rivals) if among is None else list(among)
        weights = np.array([self._rivals[name].weight for name in names])
        return names[int(random.choice(len(names), p=weights / weights.sum()))]

    def take_in(self, name: str, beaten: float) -> None:
        """Takes in a race against a rival; one that has gone is left alone."""
        if name in self._rivals:
            self._rivals[name].take_in(beaten)

    def state(self) -> list[dict[str, Any]]:
        """All of it, as JSON has it."""
        return [asdict(rival) for rival in self.rivals]

    def restore(self, state: Sequence[Mapping[str, Any]]) -> None:
        """Makes it what :meth:`state` was."""
        self._rivals = {kept["name"]: Rival(**kept) for kept in state}
