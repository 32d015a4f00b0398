"""Two agents compared, race by race."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from stkzoo.errors import ConfigError
from stkzoo.evaluation.benchmark.plan import BenchmarkResult
from stkzoo.evaluation.benchmark.races import (
    FIGURES,
    FigureKind,
    RaceGroup,
    RaceOutcome,
    find_group,
    group_races,
)
from stkzoo.evaluation.statistics import CONFIDENCE
from stkzoo.race.document import Document


@dataclass(frozen=True, slots=True)
class Comparison(Document):
    """The differences between two agents.

    Attributes:
        first: the first agent's name.
        second: the second's.
        differences: over all races and over parts of them; their figures are the first agent's
            minus the second's.
    """

    kind: ClassVar[str] = "benchmark-comparison"
    origin: ClassVar[str] = "the output of `stkzoo benchmark --compare --json`"

    first: str
    second: str
    differences: tuple[RaceGroup, ...]

    def difference(self, by: str = "all", name: str = "") -> RaceGroup:
        """The differences in some races.

        Raises:
            KeyError: there are no such races.
        """
        return find_group(self.differences, by, name)

    def to_dict(self) -> dict[str, Any]:
        """The comparison as JSON values."""
        interval = {"kind": "bootstrap over pairs of races", "confidence": CONFIDENCE}
        return {"interval": interval, **Document.to_dict(self)}


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
    others = {race.key: race for race in second.races}
    shared = [race for race in first.races if race.key in others]
    if not shared:
        raise ConfigError(
            f"{first.label} and {second.label} have no race in common; give both the same tracks, "
            "directions and forms"
        )

    def minus(kind: FigureKind) -> FigureKind:
        def difference(mine: RaceOutcome) -> float | None:
            one, two = kind.of(mine), kind.of(others[mine.key])
            return None if one is None or two is None else one - two

        return FigureKind(kind.name, difference, kind.bounds and (-kind.bounds[1], kind.bounds[1]))

    groups = group_races(shared, [minus(kind) for kind in FIGURES])
    return Comparison(first.label, second.label, groups)
