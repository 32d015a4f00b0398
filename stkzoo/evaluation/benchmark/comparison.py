"""The comparison of the benchmark results of two agents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.plan import describe_differences
from stkzoo.evaluation.benchmark.plan import BenchmarkPlan, BenchmarkResult
from stkzoo.evaluation.benchmark.races import (
    FigureKind,
    FloatArray,
    RaceGroup,
    RaceOutcome,
    find_group,
    group_races,
)
from stkzoo.evaluation.statistics import CONFIDENCE
from stkzoo.race.document import Document


@dataclass(frozen=True, slots=True)
class Comparison(Document):
    """The differences between the results of two agents.

    Attributes:
        first: name of the first agent.
        second: name of the second agent.
        differences: differences over all races and over groups of races: metrics of the first
            agent minus those of the second.
    """

    kind: ClassVar[str] = "benchmark-comparison"
    origin: ClassVar[str] = "the output of `stkzoo benchmark --compare --json`"

    first: str
    second: str
    differences: tuple[RaceGroup, ...]

    def difference(self, by: str = "all", name: str = "") -> RaceGroup:
        """Returns the differences in a group of races.

        Args:
            by: what the races have in common, as in :attr:`RaceGroup.by`.
            name: name of the group, as in :attr:`RaceGroup.name`.

        Raises:
            KeyError: there is no such group.
        """
        return find_group(self.differences, by, name)

    def to_dict(self) -> dict[str, Any]:
        """Returns the comparison as JSON values."""
        interval = {"kind": "bootstrap over pairs of races", "confidence": CONFIDENCE}
        return {"interval": interval, **Document.to_dict(self)}


def compare(first: BenchmarkResult, second: BenchmarkResult) -> Comparison:
    """Compares two agents in the races that both have driven.

    Each race is paired with the other agent's race with the same track, direction, form, end of
    the grid and seed, so the effects of these conditions cancel out.

    Args:
        first: result of the first agent.
        second: result of the second agent.

    Raises:
        ConfigError: the agents raced under different conditions, or have no race in common.
    """
    if differing := _differing_conditions(first.plan, second.plan):
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

    def minus(metric: FigureKind) -> FigureKind:
        def difference(race: RaceOutcome) -> float | None:
            one, two = metric.of(race), metric.of(others[race.key])
            return None if one is None or two is None else one - two

        def redrawn_difference(race: RaceOutcome) -> FloatArray:
            assert metric.redrawn is not None  # noqa: S101 - only called if it is not
            return metric.redrawn(race) - metric.redrawn(others[race.key])

        return FigureKind(
            metric.name,
            difference,
            metric.bounds and (-metric.bounds[1], metric.bounds[1]),
            metric.redrawn and redrawn_difference,
        )

    groups = group_races(shared, [minus(metric) for metric in first.figure_kinds()])
    return Comparison(first.label, second.label, groups)


def _differing_conditions(first: BenchmarkPlan, second: BenchmarkPlan) -> list[str]:
    """Describes the conditions whose difference makes two results incomparable."""
    one, two = _conditions(first), _conditions(second)
    shared = one.keys() & two.keys()  # of the AI's times, those on tracks of both
    return describe_differences(
        {name: one[name] for name in shared}, {name: two[name] for name in shared}
    )


def _conditions(plan: BenchmarkPlan) -> dict[str, Any]:
    times = {
        f"the AI's time on {track} ({direction})": time
        for track, of_track in plan.ai_times.items()
        for direction, time in of_track.items()
    }
    return times | {
        "engine": plan.versions.get("pystk2"),
        "difficulty": plan.settings.difficulty,
        "limit": plan.limit,
    }
