"""The players of a league, and their matchmaking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from string import ascii_lowercase
from typing import Annotated

import numpy as np

from stkzoo._schema import Count, matching, one_of

from ..common.matches import SEATS, Match, MatchRecord
from ..ppo.opponents import ITSELF, DuelResults, Matchmaker, Odds, Rival

#: Kinds of players.
MAIN, EXPLOITER, LEAGUE_EXPLOITER = "main", "exploiter", "league-exploiter"
#: Name of the member that all players start from.
START = "start"
#: Fraction of its races in which a main player meets itself.
_SELF_PLAY = 0.5
#: Fraction of won duels at which an exploiter has succeeded.
_WON = 0.7
#: Below this fraction of duels won against the newest main player, exploiters meet older ones too.
_TOO_STRONG = 0.2
#: First starting point of matches; training numbers its starting points from 0.
_FIRST_NUMBER = 2000


@dataclass(slots=True)
class Player:
    """A player of the league.

    Attributes:
        name: name of the player.
        kind: main, exploiter or league exploiter.
        generation: number of times it has started over.
        turns: turns since it last started over.
        past_turns: turns of earlier generations.
        kart_steps: training kart-steps since it last started over.
    """

    name: Annotated[str, matching(r"[a-z-]+")]
    kind: Annotated[str, one_of(MAIN, EXPLOITER, LEAGUE_EXPLOITER)]
    generation: Count = 0
    turns: Count = 0
    past_turns: Count = 0
    kart_steps: Count = 0

    @property
    def total_turns(self) -> int:
        """Turns in all generations."""
        return self.past_turns + self.turns

    @property
    def folder(self) -> str:
        """Folder of its run."""
        return f"{self.name}-g{self.generation}"

    def is_done(self, beaten: float, patience: int) -> bool:
        """Returns whether the player starts over; a main player never does.

        Args:
            beaten: fraction of duels won in the last turn.
            patience: maximum number of turns.
        """
        return self.kind != MAIN and (beaten >= _WON or self.turns >= patience)

    def start_over(self) -> None:
        """Drops the learned policy; its past selves stay in the league."""
        self.generation += 1
        self.past_turns += self.turns
        self.turns = self.kart_steps = 0


@dataclass(frozen=True, slots=True)
class LeagueMember:
    """A past self in a league.

    Attributes:
        name: name of its policy's file.
        player: the player whose past self it is; empty for the policy that all start from.
        turn: turns that had been played.
        kart_steps: kart-steps that its generation had learned from.
        league_steps: kart-steps of all players until then.
    """

    name: Annotated[str, matching(r"[a-z0-9-]+")]
    player: str
    turn: Count
    kart_steps: Count
    league_steps: Count


def new_players(mains: int, exploiters: int, league_exploiters: int) -> list[Player]:
    """Returns new players of each kind, at most 26, in the order of their turns."""
    players = []
    counts = ((MAIN, mains), (EXPLOITER, exploiters), (LEAGUE_EXPLOITER, league_exploiters))
    for role, count in counts:
        letters = ascii_lowercase[:count]
        names = [role] if count == 1 else [f"{role}-{letter}" for letter in letters]
        players += [Player(name, role) for name in names]
    return players


class PlayerMatchmaker(Matchmaker):
    """Determines the opponents of a player in its turn.

    Args:
        player: the player whose turn it is.
        members: past selves in the league, the oldest first.
    """

    def __init__(self, player: Player, members: Sequence[LeagueMember]) -> None:
        super().__init__()
        self._kind_of_player = player.kind
        self._all = [member.name for member in members]
        self._mains = [m.name for m in members if m.player.partition("-")[0] == MAIN]
        self._meet_members()

    def odds(self) -> Odds:
        """Returns the probability of each opponent in a new race."""
        if self._kind_of_player == MAIN:
            met = self.prioritized(self._all)
            return {
                ITSELF: _SELF_PLAY,
                **{n: (1 - _SELF_PLAY) * chance for n, chance in met.items()},
            }
        if self._kind_of_player != EXPLOITER or not self._mains:
            return self.prioritized(self._all)
        newest = self._mains[-1]
        if self.pool[newest].beaten >= _TOO_STRONG:
            return {newest: 1.0}
        odds = {name: 0.5 * chance for name, chance in self.prioritized(self._mains).items()}
        return {**odds, newest: odds[newest] + 0.5}

    def restore(self, results: DuelResults) -> None:
        """Restores the results of earlier turns; members that came later are new."""
        super().restore(results)
        self._meet_members()

    def beaten(self) -> float:
        """Fraction of duels won in this turn; 0 without duels."""
        return float(np.mean(self.reported)) if self.reported else 0.0

    def _meet_members(self) -> None:
        for name in self._all:
            self.pool.setdefault(name, Rival(name))


def draw_matches(
    newest: str,
    members: Sequence[str],
    records: Sequence[MatchRecord],
    tracks: Sequence[str],
    count: int,
    random: np.random.Generator,
) -> list[Match]:
    """Draws matches of the newest member with the members that it has met least.

    Args:
        newest: name of the newest member.
        members: names of all members.
        records: records of previous matches.
        tracks: tracks, driven in turn and in both directions.
        count: number of matches.
        random: random generator for ties.
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
