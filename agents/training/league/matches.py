"""Matches between the members of a league: whom the newest one meets, and who beats whom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..common.matches import Match, MatchDriver, MatchRecord, play_matches

#: The name of the game's AI at its hardest in orders of finish.
AI = "ai"
#: Members in a match; one kart of the game's AI is in it too.
SEATS = 4
#: Matches have other starting points than races of learning, which are numbered from 0.
_FIRST_NUMBER = 2000


def draw_matches(
    newest: str,
    members: Sequence[str],
    records: Sequence[MatchRecord],
    tracks: Sequence[str],
    count: int,
    random: np.random.Generator,
) -> list[Match]:
    """Matches of the newest member with the others that it has met least.

    Args:
        newest: its name.
        members: all names.
        records: of the matches that were played.
        tracks: driven in turn, in both directions.
        count: how many.
        random: decides between equals.
    """
    others = [name for name in members if name != newest]
    met = {name: sum(name in r.order for r in records if newest in r.order) for name in others}
    matches = []
    for number in range(count):
        chosen = sorted(others, key=lambda name: (met[name], random.random()))[: SEATS - 1]
        for name in chosen:
            met[name] += 1
        drivers = [newest, *chosen]
        drivers += [newest] * (SEATS - len(drivers))
        track = tracks[number % len(tracks)]
        reverse = number // len(tracks) % 2 == 1
        matches.append(Match(tuple(drivers), track, reverse, _FIRST_NUMBER + number))
    return matches


def play_records(
    matches: Sequence[Match], drivers: Mapping[str, MatchDriver], turn: int = 0
) -> list[MatchRecord]:
    """Plays matches; their records.

    Args:
        matches: the matches, each with one kart of the game's AI.
        drivers: by name.
        turn: of the league.
    """
    played = zip(matches, play_matches(matches, drivers), strict=True)
    return [MatchRecord(turn, m.track, m.reverse, m.order(ends, AI)) for m, ends in played]


def payoff(one: str, other: str, records: Sequence[MatchRecord]) -> tuple[float, int]:
    """The share of matches in which one was ahead of the other, and how many there were."""
    duels = [
        r.order.index(one) < r.order.index(other) for r in records if {one, other} <= {*r.order}
    ]
    return (float(np.mean(duels)) if duels else 0.5), len(duels)
