"""The standings of a tournament: summaries of its races and the results of each agent."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Annotated

from msgspec import Meta

from stkzoo._schema import Count, Positive, Whole
from stkzoo.evaluation.batch.entrants import Entrant
from stkzoo.evaluation.ratings import Rating
from stkzoo.race.result import AgentResult, RaceResult

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
        entrant: Entrant,
        place: int,
        rating: Rating,
        races: Sequence[RaceSummary],
        results: Mapping[int, RaceResult],
    ) -> Standing:
        """Returns the results of an agent.

        Args:
            entrant: the agent.
            place: place by rating.
            rating: rating of the agent.
            races: all races.
            results: results of all races by number.
        """
        own = [race for race in races if entrant.label in race.order]
        ranks = [race.place_of(entrant.label) for race in own]
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
            failed=sum(row.num_errors > 0 for row in rows),
        )


def _reason(rows: Sequence[AgentResult]) -> str:
    """Returns an agent's most frequent first failure in a race as one line; empty if none."""
    firsts = (" ".join(row.errors[0].message.split()) for row in rows if row.errors)
    most = Counter(text[:_MAX_REASON] for text in firsts).most_common(1)
    return most[0][0] if most else ""


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None
