"""Matches between the members of a league: who comes in before whom, and how good they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stkzoo.agents.planning import DriverParameters
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.evaluation.ratings import Rating, rate

from ..common.fleet import Finish, Fleet, RaceForm
from ..sb3.matches import finishing_order
from .learner import rows_of

__all__ = ["AI", "Match", "Pairing", "draw_pairings", "payoff", "play", "ratings_of"]

#: What the game's AI at its hardest is called in orders.
AI = "ai"
#: Members in a match; one of the game's AI drives too.
SEATS = 4
#: Matches begin elsewhere than races of learning, which are numbered from 0.
_FIRST_NUMBER = 2000
#: So many are played at a time.
_SIDE_BY_SIDE = 16


@dataclass(frozen=True, slots=True)
class Pairing:
    """A match to be played.

    Attributes:
        members: who drives; some may be there twice if there are too few.
        track: its name.
        reverse: the other way round.
        number: of its beginning.
    """

    members: tuple[str, ...]
    track: str
    reverse: bool
    number: int


@dataclass(frozen=True, slots=True)
class Match:
    """A match that was played.

    Attributes:
        turn: after which turn of the league.
        track: its name.
        reverse: the other way round.
        order: who came in first, second, ...; each member once, at its better place.
    """

    turn: int
    track: str
    reverse: bool
    order: list[str]


def draw_pairings(
    newest: str,
    members: Sequence[str],
    matches: Sequence[Match],
    tracks: Sequence[str],
    count: int,
    random: np.random.Generator,
) -> list[Pairing]:
    """Matches of the newest member with others, those it has met least.

    Args:
        newest: its name.
        members: all of them.
        matches: those that were played.
        tracks: driven in turn, both ways.
        count: how many.
        random: decides between equals.
    """
    others = [name for name in members if name != newest]
    met = {name: sum(name in m.order for m in matches if newest in m.order) for name in others}
    pairings = []
    for number in range(count):
        order = sorted(others, key=lambda name: (met[name], random.random()))
        chosen = order[: SEATS - 1]
        for name in chosen:
            met[name] += 1
        seats = [newest, *chosen]
        seats += [newest] * (SEATS - len(seats))
        track = tracks[number % len(tracks)]
        reverse = number // len(tracks) % 2 == 1
        pairings.append(Pairing(tuple(seats), track, reverse, _FIRST_NUMBER + number))
    return pairings


def play(
    pairings: Sequence[Pairing],
    policies: Mapping[str, RacingPolicy],
    turn: int,
    rules: DriverParameters | None = None,
) -> list[Match]:
    """Plays matches, all by likeliest choices.

    Args:
        pairings: the matches.
        policies: of all members in them.
        turn: of the league.
        rules: the numbers that everybody's plans go by.
    """
    played: list[Match] = []
    for first in range(0, len(pairings), _SIDE_BY_SIDE):
        some = pairings[first : first + _SIDE_BY_SIDE]
        tracks = [pairing.track for pairing in some]
        form = RaceForm(SEATS, 1)
        fleet = Fleet([form] * len(some), tracks, 0, rules=rules, goes_on=False)
        try:
            played += _play(fleet, some, policies, turn)
        finally:
            fleet.close()
    return played


def _play(
    fleet: Fleet, pairings: Sequence[Pairing], policies: Mapping[str, RacingPolicy], turn: int
) -> list[Match]:
    """Matches side by side."""
    view = fleet.begin_at([(p.track, p.reverse, p.number) for p in pairings])
    seats = np.array([name for pairing in pairings for name in pairing.members])
    rows = {str(name): np.flatnonzero(seats == name) for name in np.unique(seats)}
    ends: dict[int, Finish] = {}
    while fleet.active.any():
        choices = np.zeros((len(seats), 4), np.intp)
        for name, own in rows.items():
            choices[own] = policies[name].best(rows_of(view, own))
        fleet.send(choices)
        view, outcome = fleet.receive()
        ended = np.flatnonzero(outcome.ended).tolist()
        ends.update(zip(ended, outcome.finishes, strict=True))
    return [
        Match(turn, pairing.track, pairing.reverse, _order(pairing, number * SEATS, ends))
        for number, pairing in enumerate(pairings)
    ]


def _order(pairing: Pairing, first: int, ends: Mapping[int, Finish]) -> list[str]:
    """Who came in first, second, ... in the match whose first seat has this number."""
    places = {ends[first + seat].rank: name for seat, name in enumerate(pairing.members)}
    return finishing_order(places, AI)


def ratings_of(matches: Sequence[Match]) -> dict[str, Rating]:
    """Everybody's rating; 25 is the mean.

    Raises:
        ConfigError: the library of the ratings is not installed.
    """
    names = sorted({name for match in matches for name in match.order})
    numbers = {name: number for number, name in enumerate(names)}
    races = [[numbers[name] for name in match.order] for match in matches]
    return dict(zip(names, rate(races, len(names)), strict=True))


def payoff(one: str, other: str, matches: Sequence[Match]) -> tuple[float, int]:
    """The share of matches in which one was before the other, and how many there were."""
    duels = [
        m.order.index(one) < m.order.index(other) for m in matches if {one, other} <= {*m.order}
    ]
    return (float(np.mean(duels)) if duels else 0.5), len(duels)
