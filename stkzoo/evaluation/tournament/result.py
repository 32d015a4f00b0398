"""The result of a tournament: standings, ratings and the payoff matrix."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import fmean

from stkzoo.evaluation.ratings import Rating, rate
from stkzoo.evaluation.statistics import CONFIDENCE
from stkzoo.evaluation.tournament.plan import TournamentPlan
from stkzoo.race.result import AgentResult, RaceResult

#: Of the JSON file (``docs/schemas/tournament-result.schema.json``).
SCHEMA_VERSION = 1


@dataclass(frozen=True, slots=True)
class Standing:
    """The results of one agent.

    Attributes:
        place: by rating, 1 is best.
        label: its name.
        source: its driver name or path.
        rating: its rating, with an interval.
        races: races it was in.
        wins: races it won.
        mean_rank: its mean rank in them; ``None`` without races.
        finished: races it finished.
        retired: races it was removed from because it failed.
        errors: how often it failed.
        mean_time: mean time of the races it finished [s]; ``None`` without.
        track_ranks: its mean rank on each track it raced on.
    """

    place: int
    label: str
    source: str
    rating: Rating
    races: int
    wins: int
    mean_rank: float | None
    finished: int
    retired: int
    errors: int
    mean_time: float | None
    track_ranks: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class RaceSummary:
    """One race: number, track, seed, status, and the agents in finishing order."""

    number: int
    track: str
    seed: int
    status: str
    order: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class TournamentResult:
    """The result of a tournament.

    Attributes:
        plan: the tournament.
        standings: one per agent, best first.
        ahead: ``ahead[i][j]``: in how many races the agent of ``standings[i]`` finished ahead
            of that of ``standings[j]``.
        races: the races that have been run.
    """

    plan: TournamentPlan
    standings: tuple[Standing, ...]
    ahead: tuple[tuple[int, ...], ...]
    races: tuple[RaceSummary, ...]

    @property
    def is_complete(self) -> bool:
        """Whether all races have been run."""
        return len(self.races) == self.plan.races

    def payoff(self, one: int, two: int) -> float | None:
        """The share of their races in which one agent of ``standings`` beat another."""
        won, lost = self.ahead[one][two], self.ahead[two][one]
        return won / (won + lost) if won + lost else None

    def to_json(self) -> str:
        """The result as JSON (``docs/schemas/tournament-result.schema.json``)."""
        everybody = range(len(self.standings))
        values = {
            "type": "tournament-result",
            "schema_version": SCHEMA_VERSION,
            "is_complete": self.is_complete,
            "rating_model": {
                "name": "plackett-luce",
                "interval": "bootstrap over races",
                "confidence": CONFIDENCE,
            },
            "standings": [
                {**asdict(row), "track_ranks": dict(row.track_ranks)} for row in self.standings
            ],
            "ahead": self.ahead,
            "payoff": [[self.payoff(one, two) for two in everybody] for one in everybody],
            "races": [asdict(race) for race in self.races],
            "plan": self.plan.to_dict(),
        }
        return json.dumps(values, indent=2, allow_nan=False)


def tournament_result(plan: TournamentPlan, results: Mapping[int, RaceResult]) -> TournamentResult:
    """Summarizes the races that have been run.

    An agent that was removed from a race because it failed ranks behind all that were not.

    Args:
        plan: the tournament.
        results: of its races, by number.

    Raises:
        ConfigError: openskill is not installed.
    """
    number_of = {entrant.label: number for number, entrant in enumerate(plan.entrants)}
    orders = {number: _order(results[number]) for number in sorted(results)}
    ranked = [[number_of[row.driver] for row in order] for order in orders.values()]
    ratings = rate(ranked, len(plan.entrants), plan.seed)
    best_first = sorted(number_of.values(), key=lambda number: -ratings[number].value)
    return TournamentResult(
        plan=plan,
        standings=tuple(
            _standing(plan, agent, place, ratings[agent], results, orders)
            for place, agent in enumerate(best_first, 1)
        ),
        ahead=tuple(
            tuple(
                sum(one in order and two in order[order.index(one) + 1 :] for order in ranked)
                for two in best_first
            )
            for one in best_first
        ),
        races=tuple(
            RaceSummary(
                number,
                results[number].track,
                results[number].seed,
                results[number].status,
                tuple(row.driver for row in order),
            )
            for number, order in orders.items()
        ),
    )


def _order(result: RaceResult) -> list[AgentResult]:
    return sorted(result.agents, key=lambda row: (row.status == "retired", row.rank))


def _standing(
    plan: TournamentPlan,
    agent: int,
    place: int,
    rating: Rating,
    results: Mapping[int, RaceResult],
    orders: Mapping[int, Sequence[AgentResult]],
) -> Standing:
    entrant = plan.entrants[agent]
    entries = [
        (results[number].track, rank, row)
        for number, order in orders.items()
        for rank, row in enumerate(order, 1)
        if row.driver == entrant.label
    ]
    ranks = [rank for _, rank, _ in entries]
    rows = [row for _, _, row in entries]
    times = [row.finish_time for row in rows if row.finish_time is not None]
    return Standing(
        place=place,
        label=entrant.label,
        source=entrant.source,
        rating=rating,
        races=len(rows),
        wins=ranks.count(1),
        mean_rank=_mean(ranks),
        finished=len(times),
        retired=sum(row.status == "retired" for row in rows),
        errors=sum(row.num_errors for row in rows),
        mean_time=_mean(times),
        track_ranks={
            track: fmean(rank for on, rank, _ in entries if on == track)
            for track in sorted({track for track, _, _ in entries})
        },
    )


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None
