"""Two agents compared, race by race."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

from stkzoo.errors import ConfigError
from stkzoo.evaluation.benchmark.result import FIGURES, BenchmarkResult, RaceOutcome, groups_of
from stkzoo.evaluation.statistics import CONFIDENCE, Estimate, estimate_known

Pair = tuple[RaceOutcome, RaceOutcome]


@dataclass(frozen=True, slots=True)
class GroupDifference:
    """The difference between two agents in a group of races.

    Attributes:
        by: what the races have in common, as in :class:`~stkzoo.evaluation.RaceGroup`.
        name: which of these.
        races: how many.
        figures: the first agent's figure minus the second's, by name; ``None`` for a figure
            that no race has.
    """

    by: str
    name: str
    races: int
    figures: Mapping[str, Estimate | None]


@dataclass(frozen=True, slots=True)
class Comparison:
    """The differences between two agents.

    Attributes:
        first: the first agent's name.
        second: the second's.
        differences: over all races and over parts of them.
    """

    first: str
    second: str
    differences: tuple[GroupDifference, ...]

    def difference(self, by: str = "all", name: str = "") -> GroupDifference:
        """The differences in some races.

        Raises:
            KeyError: there are no such races.
        """
        return {(entry.by, entry.name): entry for entry in self.differences}[by, name]

    def to_json(self) -> str:
        """The comparison as JSON."""
        values = {
            "type": "benchmark-comparison",
            "schema_version": 1,
            "interval": {"kind": "bootstrap over pairs of races", "confidence": CONFIDENCE},
            **asdict(self),
        }
        return json.dumps(values, indent=2, allow_nan=False)


def compare(first: BenchmarkResult, second: BenchmarkResult) -> Comparison:
    """The differences between two agents in the races that both have driven.

    Each race is compared with the other agent's race of the same track, direction, form, end of
    the grid and seed, so the conditions of a race cancel out.

    Raises:
        ConfigError: they raced under different conditions, or have no race in common.
    """
    differing = first.plan.differing_conditions(second.plan)
    if differing:
        raise ConfigError(
            f"{first.label} and {second.label} raced under different conditions: "
            f"{'; '.join(differing)}. Run the benchmark again for one of them"
        )
    others = {_key(outcome): outcome for outcome in second.outcomes}
    mine = [outcome for outcome in first.outcomes if _key(outcome) in others]
    if not mine:
        raise ConfigError(
            f"{first.label} and {second.label} have no race in common; give both the same tracks, "
            "directions and forms"
        )
    return Comparison(
        first.label,
        second.label,
        tuple(
            GroupDifference(
                by,
                name,
                len(members),
                _figures([(outcome, others[_key(outcome)]) for outcome in members]),
            )
            for (by, name), members in groups_of(mine).items()
        ),
    )


def _key(outcome: RaceOutcome) -> tuple[object, ...]:
    return (*outcome.race.kind, outcome.race.index)


def _figures(pairs: Sequence[Pair]) -> dict[str, Estimate | None]:
    strata = [mine.race.kind for mine, _ in pairs]
    figures = {}
    for kind in FIGURES:
        values = [_difference(kind.of(mine), kind.of(other)) for mine, other in pairs]
        bounds = None if kind.bounds is None else (-kind.bounds[1], kind.bounds[1])
        figures[kind.name] = estimate_known(values, strata, bounds)
    return figures


def _difference(one: float | None, two: float | None) -> float | None:
    return None if one is None or two is None else one - two
