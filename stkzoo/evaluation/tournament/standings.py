"""The standings of a tournament: what each race and each agent came to."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Annotated

from stkzoo._schema import Count, Positive, Whole, Within
from stkzoo.evaluation.batch.entrants import Entrant
from stkzoo.evaluation.ratings import Rating
from stkzoo.race.result import AgentResult, RaceResult

_MAX_REASON = 200


@dataclass(frozen=True, slots=True)
class RaceSummary:
    """One race: number, track, seed, status, and the agents in finishing order."""

    number: Count
    track: str
    seed: Count
    status: str
    order: tuple[str, ...]

    @classmethod
    def of(cls, number: int, result: RaceResult) -> RaceSummary:
        """The summary of a race. Agents that were removed because they failed are last."""
        rows = sorted(result.agents, key=lambda row: (row.status == "retired", row.rank))
        order = tuple(row.driver for row in rows)
        return cls(number, result.track, result.seed, result.status, order)


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
        reason: its most frequent failure, in one line; empty without failures.
    """

    place: Whole
    label: str
    source: str
    rating: Rating
    races: Count
    wins: Count
    mean_rank: Annotated[float, Within(1)] | None
    finished: Count
    retired: Count
    errors: Count
    mean_time: Positive | None
    track_ranks: Mapping[str, Annotated[float, Within(1)]]
    reason: str = ""

    @classmethod
    def of(
        cls,
        entrant: Entrant,
        place: int,
        rating: Rating,
        races: Sequence[RaceSummary],
        results: Mapping[int, RaceResult],
    ) -> Standing:
        """The results of an agent in some races.

        Args:
            entrant: the agent.
            place: by rating.
            rating: its rating.
            races: all races.
            results: of these, by number.
        """
        own = [race for race in races if entrant.label in race.order]
        ranks = [race.order.index(entrant.label) + 1 for race in own]
        agents = [row for race in own for row in results[race.number].agents]
        rows = [row for row in agents if row.driver == entrant.label]
        times = [row.finish_time for row in rows if row.finish_time is not None]
        track_ranks: dict[str, list[int]] = defaultdict(list)
        for race, rank in zip(own, ranks, strict=True):
            track_ranks[race.track].append(rank)
        return cls(
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
            track_ranks={track: fmean(on_track) for track, on_track in sorted(track_ranks.items())},
            reason=_reason(rows),
        )


def _reason(rows: Sequence[AgentResult]) -> str:
    """The most frequent first failure of an agent, in one line."""
    firsts = (" ".join(row.errors[0].message.split()) for row in rows if row.errors)
    most = Counter(text[:_MAX_REASON] for text in firsts).most_common(1)
    return most[0][0] if most else ""


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None
