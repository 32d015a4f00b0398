"""Past selves as opponents: the matchmaker, and the assignment of karts in a race.

Prioritized fictitious self-play (Vinyals et al., "Grandmaster level in StarCraft II using
multi-agent reinforcement learning", 2019) draws an opponent that is beaten with probability p with
weight (1 - p)^2. This avoids forgetting and spends little time on opponents that the learner beats
anyway. Here, the weight is (1 - p)^2 + 0.02, so that every opponent can be drawn. Fictitious
self-play (Heinrich et al., 2015) draws all past selves with equal probability, so that the learner
finds a response to their mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._schema import Count, Share

#: Weight of one race in the win rate against an opponent.
_RATE = 0.1
#: Added to each weight, so that every opponent can be drawn.
_LEAST_WEIGHT = 0.02
#: Name of the learner itself in odds.
ITSELF = ""
#: Kinds of :class:`Matchmaker`.
NOBODY, FICTITIOUS, PRIORITIZED = OPPONENTS = "none", "fictitious", "prioritized"

#: Probability of each opponent by name; an empty name is the learner itself.
Odds = Mapping[str, float]


@dataclass(slots=True)
class Rival:
    """An opponent in the pool.

    Attributes:
        name: name of a past self.
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


def draw_opponent(odds: Odds, random: np.random.Generator) -> str:
    """Draws an opponent's name by its probability; the learner itself without odds."""
    return list(odds)[int(random.choice(len(odds), p=list(odds.values())))] if odds else ITSELF


@dataclass(frozen=True, slots=True)
class DuelResults:
    """The state of a :class:`Matchmaker`.

    Attributes:
        pool: the opponents.
        reported: fractions of duels won in the races so far.
    """

    pool: list[Rival] = field(default_factory=list)
    reported: list[Share] = field(default_factory=list)


class Matchmaker:
    """Determines how often the learner meets each past self, from the results of their duels.

    Args:
        opponents: ``"none"``, ``"fictitious"`` or ``"prioritized"``.
        size: number of past selves to keep; when full, a new one replaces the most beaten one.
        share: share of the races in which a past self drives some of the karts.

    Attributes:
        pool: the past selves by name, the oldest first.
        reported: fractions of duels won.
    """

    def __init__(self, opponents: str = NOBODY, size: int = 40, share: float = 0.5) -> None:
        self._opponents, self._size, self._share = opponents, size, share
        self.pool: dict[str, Rival] = {}
        self.reported: list[float] = []

    def add(self, name: str) -> None:
        """Adds a past self."""
        if self._opponents == NOBODY:
            return
        if name not in self.pool and len(self.pool) >= self._size:
            del self.pool[max(self.pool.values(), key=lambda rival: rival.beaten).name]
        self.pool.setdefault(name, Rival(name))

    def odds(self) -> Odds:
        """Returns the probability of each opponent in a new race."""
        chances = self.prioritized(list(self.pool))
        if self._opponents == FICTITIOUS:
            chances = dict.fromkeys(chances, 1 / max(len(chances), 1))
        met = {name: self._share * chance for name, chance in chances.items()}
        return {ITSELF: 1.0 - self._share, **met} if met else {}

    def prioritized(self, names: Sequence[str]) -> dict[str, float]:
        """Returns the probability of each of some past selves, higher the less it is beaten."""
        weights = np.array([(1.0 - self.pool[name].beaten) ** 2 for name in names]) + _LEAST_WEIGHT
        return dict(zip(names, (weights / weights.sum()).tolist(), strict=True))

    def update(self, name: str, beaten: float) -> None:
        """Adds the fraction of duels with an opponent that the learner won in a race.

        The opponent may no longer be in the pool.
        """
        if name in self.pool:
            self.pool[name].update(beaten)
        self.reported.append(beaten)

    def figures(self) -> dict[str, float]:
        """Returns the mean fraction of duels won against an opponent; empty without duels."""
        beaten = [rival.beaten for rival in self.pool.values() if rival.races]
        return {"beaten": float(np.mean(beaten))} if beaten else {}

    def state(self) -> dict[str, Any]:
        """Returns the results as JSON values."""
        return {"pool": list(map(asdict, self.pool.values())), "reported": self.reported}

    def restore(self, results: DuelResults) -> None:
        """Restores a :meth:`state`."""
        self.pool = {rival.name: replace(rival) for rival in results.pool}
        self.reported = list(results.reported)


class RivalSeats:
    """Which karts of some races an opponent drives, and the results of its duels.

    An opponent drives one of the teams or, without teams, half of the karts, rounded down. The
    learner drives the others and does not learn from the opponent's.

    Args:
        num_races: number of races.
        num_agents: agents of each race.
        teams: numbers of the agents of each team; empty without teams.

    Attributes:
        names: the opponent in each race; empty for none.
        is_own: ``(num_races, num_agents)`` bool, karts of the learner.
    """

    def __init__(
        self, num_races: int, num_agents: int, teams: Sequence[Sequence[int]] = ()
    ) -> None:
        self._teams = teams
        self.names = [ITSELF] * num_races
        self.is_own = np.ones((num_races, num_agents), np.bool_)
        self._positions = np.zeros((num_races, num_agents), np.intp)  # 0 while racing

    def seat(self, race: int, name: str, random: np.random.Generator) -> None:
        """Assigns karts of a new race to an opponent, or none to the learner itself."""
        count = self.is_own.shape[1]
        self.names[race], self.is_own[race], self._positions[race] = name, True, 0
        if name and self._teams:
            team = self._teams[int(random.integers(len(self._teams)))]
            self.is_own[race, list(team)] = False
        elif name:
            self.is_own[race, random.permutation(count)[: count // 2]] = False

    def rows_by_name(self) -> dict[str, npt.NDArray[np.intp]]:
        """Returns the slots of each opponent."""
        names = np.repeat(np.array(self.names), self.is_own.shape[1])
        is_rival = ~self.is_own.reshape(-1)
        return {n: np.flatnonzero((names == n) & is_rival) for n in sorted({*self.names} - {""})}

    def end(self, slot: int, position: int) -> bool:
        """Records the final position of a slot's kart; returns whether its race is over."""
        race, agent = divmod(slot, self.is_own.shape[1])
        self._positions[race, agent] = position
        return bool(self._positions[race].all())

    def beaten(self, race: int) -> float | None:
        """Returns the fraction of duels won in a race that is over; ``None`` without duels."""
        learners = self._positions[race, self.is_own[race]]
        others = self._positions[race, ~self.is_own[race]]
        return float((learners[:, None] < others).mean()) if len(others) and len(learners) else None
