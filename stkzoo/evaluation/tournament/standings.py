"""The result of a tournament: its standings, and summaries of its races."""

from __future__ import annotations

import itertools
import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import fmean
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from stkzoo._schema import Count, Positive, Whole
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.agents import BatchAgent
from stkzoo.evaluation.batch.plan import MAX_RESULT_BYTES
from stkzoo.evaluation.ratings import Rating, rate
from stkzoo.evaluation.statistics import CONFIDENCE
from stkzoo.evaluation.tournament.plan import TournamentPlan
from stkzoo.race.document import Document
from stkzoo.race.result import AgentResult, RaceResult, shared_protections

_MAX_REASON = 200


@dataclass(frozen=True, slots=True)
class RaceSummary:
    """The summary of one race.

    Attributes:
        number: number of the race.
        track: name of the track.
        seed: seed of the race.
        status: why the race ended.
        order: labels of the agents in finishing order.
        retired: number of agents that were removed after a failure. They are last in ``order``.
    """

    number: Count
    track: str
    seed: Count
    status: str
    order: tuple[str, ...]
    retired: Count = 0

    @classmethod
    def of(cls, number: int, result: RaceResult) -> RaceSummary:
        """Returns the summary of a race. Agents that were removed after a failure come last.

        Args:
            number: number of the race.
            result: result of the race.
        """
        rows = sorted(result.agents, key=lambda row: (row.status == "retired", row.rank))
        order = tuple(row.driver for row in rows)
        retired = sum(row.status == "retired" for row in rows)
        return cls(number, result.track, result.seed, result.status, order, retired)

    def place_of(self, label: str) -> int:
        """Returns the place of an agent of the race, from 1. All retired agents share the last one.

        Args:
            label: name of the agent.
        """
        index, last = self.order.index(label), len(self.order)
        return index + 1 if index < last - self.retired else last


@dataclass(frozen=True, slots=True)
class Standing:
    """The results of one agent.

    Attributes:
        place: place by rating; 1 is best.
        label: name of the agent.
        source: driver name or path of the agent.
        rating: rating with an interval.
        races: number of races.
        wins: number of races won.
        mean_rank: mean place; ``None`` without races.
        finished: number of races finished.
        retired: number of races from which the agent was removed after a failure.
        errors: number of failures.
        mean_time: mean finish time [s]; ``None`` if the agent finished no race.
        track_ranks: mean place on each track.
        reason: the most frequent failure as one line; empty without failures.
        failed: number of races with failures.
    """

    place: Whole
    label: str
    source: str
    rating: Rating
    races: Count
    wins: Count
    mean_rank: Annotated[float, Meta(ge=1)] | None
    finished: Count
    retired: Count
    errors: Count
    mean_time: Positive | None
    track_ranks: Mapping[str, Annotated[float, Meta(ge=1)]]
    reason: str = ""
    failed: Count = 0

    @classmethod
    def of(
        cls,
        agent: BatchAgent,
        place: int,
        rating: Rating,
        races: Sequence[RaceSummary],
        results: Mapping[int, RaceResult],
    ) -> Standing:
        """Returns the results of an agent.

        Args:
            agent: the agent.
            place: place by rating.
            rating: rating of the agent.
            races: all races.
            results: results of all races by number.
        """
        driven = races_of(agent.label, races, results)
        ranks, rows = [rank for _, rank, _ in driven], [row for *_, row in driven]
        times = [row.finish_time for row in rows if row.finish_time is not None]
        track_ranks: dict[str, list[int]] = defaultdict(list)
        for race, rank, _ in driven:
            track_ranks[race.track].append(rank)
        return cls(
            place=place,
            label=agent.label,
            source=agent.source,
            rating=rating,
            races=len(rows),
            wins=ranks.count(1),
            mean_rank=_mean(ranks),
            finished=len(times),
            retired=sum(row.status == "retired" for row in rows),
            errors=sum(row.num_errors for row in rows),
            mean_time=_mean(times),
            track_ranks={track: fmean(on_track) for track, on_track in sorted(track_ranks.items())},
            reason=_reason(rows),
            failed=sum(row.num_errors > 0 for row in rows),
        )


def races_of(
    label: str, races: Sequence[RaceSummary], results: Mapping[int, RaceResult]
) -> list[tuple[RaceSummary, int, AgentResult]]:
    """Returns the summary, the place and the result of each race of an agent.

    Args:
        label: name of the agent.
        races: all races.
        results: results of all races by number.
    """
    return [
        (race, race.place_of(label), row)
        for race in races
        for row in results[race.number].agents
        if row.driver == label
    ]


def _reason(rows: Sequence[AgentResult]) -> str:
    """Returns an agent's most frequent first failure in a race as one line; empty if none."""
    firsts = (" ".join(row.errors[0].message.split()) for row in rows if row.errors)
    most = Counter(text[:_MAX_REASON] for text in firsts).most_common(1)
    return most[0][0] if most else ""


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


@dataclass(frozen=True, slots=True)
class TournamentResult(Document):
    """The result of a tournament.

    Attributes:
        plan: the tournament.
        standings: standings of the agents, best first.
        ahead: ``ahead[i][j]`` is the number of races in which the agent of ``standings[i]``
            finished ahead of the agent of ``standings[j]``. Two retired agents are tied.
        races: the races that have been run.
        sandboxes: sandboxes of the agents from files in these races.
        protections: protections that applied in all races with agents from files
            (:func:`stkzoo.drivers.sandbox.protections`).
    """

    # docs/schemas/tournament-result.schema.json
    type_name: ClassVar[str] = "tournament-result"
    origin: ClassVar[str] = "the --output of `stkzoo tournament`, or its result.json"
    max_bytes: ClassVar[int] = MAX_RESULT_BYTES

    plan: TournamentPlan
    standings: tuple[Standing, ...]
    ahead: tuple[tuple[Count, ...], ...]
    races: tuple[RaceSummary, ...]
    sandboxes: tuple[str, ...] = field(compare=False, default=())
    protections: tuple[str, ...] = field(compare=False, default=())

    def __post_init__(self) -> None:
        count = len(self.plan.agents)
        if [len(self.standings), *map(len, self.ahead)] != [count] * (1 + count):
            raise ConfigError(
                f"standings and ahead have {len(self.standings)} and {len(self.ahead)} agents, "
                f"expected {count} each"
            )

    @property
    def is_complete(self) -> bool:
        """Whether all races have been run."""
        return len(self.races) == self.plan.num_races

    @property
    def errors(self) -> int:
        """Total number of failures of agents."""
        return sum(row.errors for row in self.standings)

    @property
    def groups(self) -> tuple[int, ...]:
        """The group of each agent in ``standings``, from 1: who may be equally good.

        All intervals of a group overlap each other. The next group begins with the first agent
        whose interval ends below one of them.
        """
        groups: list[int] = []
        number, highest_low = 0, math.inf
        for row in self.standings:
            if row.rating.high < highest_low:
                number, highest_low = number + 1, row.rating.low
            highest_low = max(highest_low, row.rating.low)
            groups.append(number)
        return tuple(groups)

    def payoff(self, one: int, two: int) -> float | None:
        """Returns the fraction of their shared races in which one agent beat another.

        Args:
            one: index of the first agent in ``standings``.
            two: index of the second agent in ``standings``.

        Returns:
            The fraction of races that the first agent won; ``None`` if neither was ahead in any.
        """
        won, lost = self.ahead[one][two], self.ahead[two][one]
        return won / (won + lost) if won + lost else None

    def to_dict(self) -> dict[str, Any]:
        """Returns the result as JSON values."""
        everybody = range(len(self.standings))
        rating_model = {
            "name": "plackett-luce",
            "interval": "bootstrap over races",
            "confidence": CONFIDENCE,
        }
        return {
            "is_complete": self.is_complete,
            "rating_model": rating_model,
            **Document.to_dict(self),
            "payoff": [[self.payoff(one, two) for two in everybody] for one in everybody],
        }


def summarize_tournament(
    plan: TournamentPlan, results: Mapping[int, RaceResult]
) -> TournamentResult:
    """Returns the result after the races that have been run.

    Args:
        plan: the tournament.
        results: results of races by number.
    """
    races = tuple(RaceSummary.of(number, results[number]) for number in sorted(results))
    number_of = {agent.label: number for number, agent in enumerate(plan.agents)}
    orders = [[number_of[label] for label in race.order] for race in races]
    places = [[race.place_of(label) for label in race.order] for race in races]
    ratings = rate(orders, len(plan.agents), plan.seed, places)
    ahead = Counter(
        (one, two)
        for race in races
        for one, two in itertools.combinations(race.order, 2)
        if race.place_of(one) < race.place_of(two)
    )
    best_first = sorted(number_of.values(), key=lambda number: -ratings[number].value)
    labels = [plan.agents[number].label for number in best_first]
    sandboxes, protections = shared_protections(results.values())
    return TournamentResult(
        plan=plan,
        standings=tuple(
            Standing.of(plan.agents[number], place, ratings[number], races, results)
            for place, number in enumerate(best_first, 1)
        ),
        ahead=tuple(tuple(ahead[one, two] for two in labels) for one in labels),
        races=races,
        sandboxes=sandboxes,
        protections=protections,
    )
