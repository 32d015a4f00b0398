"""What a benchmark came to."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from stkzoo.errors import ConfigError
from stkzoo.evaluation.benchmark.outcome import RaceOutcome
from stkzoo.evaluation.benchmark.plan import BenchmarkPlan
from stkzoo.evaluation.benchmark.races import BenchmarkRace, direction_name
from stkzoo.evaluation.statistics import CONFIDENCE, Estimate, estimate_mean
from stkzoo.race.result import RaceResult, check_form, read_json

__all__ = [
    "FIGURES",
    "SCHEMA_VERSION",
    "BenchmarkResult",
    "FigureKind",
    "Group",
    "benchmark_result",
    "groups_of",
]

#: Of the JSON form (``docs/schemas/benchmark-result.schema.json``).
SCHEMA_VERSION = 1
_TYPE = "benchmark-result"


@dataclass(frozen=True, slots=True)
class FigureKind:
    """A kind of figure.

    Attributes:
        name: what it is called.
        of: its value in one race; ``None`` where it has none.
        bounds: the least and greatest possible value, for shares and counts.
    """

    name: str
    of: Callable[[RaceOutcome], float | None]
    bounds: tuple[float, float] | None = None


FIGURES = (
    FigureKind("time_ratio", lambda race: race.time_ratio),
    FigureKind("win_rate", lambda race: race.is_won, (0.0, 1.0)),
    FigureKind("mean_rank", lambda race: race.rank),
    FigureKind("unfinished", lambda race: race.unfinished, (0.0, 1.0)),
    FigureKind("rescues", lambda race: race.rescues, (0.0, float("inf"))),
)


@dataclass(frozen=True, slots=True)
class Group:
    """Some of the races, and what they came to.

    Attributes:
        by: what they have in common: ``"all"``, ``"form"``, ``"direction"``, ``"end"``,
            ``"track"`` or ``"track and direction"``.
        name: which of these; empty for all.
        races: how many.
        chance: the share of them that the agent would win if all were equally good; ``None``
            without rivals.
        figures: by name of :data:`FIGURES`; ``None`` for a figure that no race has.
    """

    by: str
    name: str
    races: int
    chance: float | None
    figures: Mapping[str, Estimate | None]


@dataclass(frozen=True)
class BenchmarkResult:
    """What a benchmark came to.

    Attributes:
        plan: what it was to be.
        outcomes: the races that have been run.
    """

    plan: BenchmarkPlan
    outcomes: tuple[RaceOutcome, ...]

    @property
    def label(self) -> str:
        """What the agent is called."""
        return self.plan.agent.label

    @property
    def is_complete(self) -> bool:
        """Whether all races have been run."""
        return len(self.outcomes) == len(self.plan.races())

    @property
    def errors(self) -> int:
        """How often the agent failed."""
        return sum(kart.errors for outcome in self.outcomes for kart in outcome.karts)

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """The figures, over all races and over parts of them."""
        return tuple(
            Group(by, name, len(members), _chance(members), _figures(members))
            for (by, name), members in groups_of(self.outcomes).items()
        )

    def group(self, by: str = "all", name: str = "") -> Group:
        """The figures of some races.

        Raises:
            KeyError: there are no such races.
        """
        for group in self.groups:
            if (group.by, group.name) == (by, name):
                return group
        raise KeyError((by, name))

    def to_json(self) -> str:
        """The result as JSON (``docs/schemas/benchmark-result.schema.json``)."""
        races = ",\n    ".join(json.dumps(outcome.to_form()) for outcome in self.outcomes)
        head = {
            "type": _TYPE,
            "schema_version": SCHEMA_VERSION,
            "agent": self.label,
            "is_complete": self.is_complete,
            "interval": {"kind": "bootstrap over races", "confidence": CONFIDENCE},
            "groups": [asdict(group) for group in self.groups],
            "plan": self.plan.to_form(),
        }
        text = json.dumps(head, indent=2, allow_nan=False)[:-2]
        return text + f',\n  "races": [\n    {races}\n  ]\n}}'

    @classmethod
    def from_json(cls, text: str) -> BenchmarkResult:
        """Reads what :meth:`to_json` wrote.

        Raises:
            ConfigError: it is something else, or of another version.
        """
        try:
            form = read_json(text)
            check_form(form, _TYPE, SCHEMA_VERSION)
            plan = BenchmarkPlan.from_form(form["plan"])
            races = {race.number: race for race in plan.races()}
            outcomes = [_outcome(entry, races[entry["number"]], plan) for entry in form["races"]]
        except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
            raise ConfigError(
                f"the text is no benchmark result ({type(error).__name__}: {error}); expected the "
                "result.json of `stkzoo benchmark`"
            ) from error
        return cls(plan, tuple(outcomes))


def benchmark_result(plan: BenchmarkPlan, results: Mapping[int, RaceResult]) -> BenchmarkResult:
    """Sums up the races that have been run.

    Args:
        plan: the benchmark.
        results: of its races, by number.
    """
    return BenchmarkResult(
        plan,
        tuple(
            RaceOutcome.of(
                race, results[race.number], plan.ai_time(race.track, race.reverse), plan.limit
            )
            for race in plan.races()
            if race.number in results
        ),
    )


def groups_of(
    outcomes: Sequence[RaceOutcome],
) -> dict[tuple[str, str], list[RaceOutcome]]:
    """The races by what they have in common, in the order in which they are shown."""
    found: dict[tuple[str, str], list[RaceOutcome]] = {}
    for by, name_of in _GROUPINGS.items():
        for outcome in outcomes:
            found.setdefault((by, name_of(outcome.race)), []).append(outcome)
    return found


_GROUPINGS: dict[str, Callable[[BenchmarkRace], str]] = {
    "all": lambda _: "",
    "form": lambda race: race.form.name,
    "direction": lambda race: direction_name(race.reverse),
    "end": lambda race: race.end if race.form.rivals else "alone",
    "track": lambda race: race.track,
    "track and direction": lambda race: f"{race.track} {direction_name(race.reverse)}",
}


def _chance(outcomes: Sequence[RaceOutcome]) -> float | None:
    chances = [outcome.race.form.chance for outcome in outcomes if outcome.race.form.rivals]
    return sum(chances) / len(chances) if chances else None


def _figures(outcomes: Sequence[RaceOutcome]) -> dict[str, Estimate | None]:
    figures: dict[str, Estimate | None] = {}
    for kind in FIGURES:
        pairs = [(kind.of(outcome), outcome.race.kind) for outcome in outcomes]
        values = [value for value, _ in pairs if value is not None]
        strata = [stratum for value, stratum in pairs if value is not None]
        figures[kind.name] = estimate_mean(values, strata, kind.bounds) if values else None
    return figures


def _outcome(form: Mapping[str, Any], race: BenchmarkRace, plan: BenchmarkPlan) -> RaceOutcome:
    found = form["track"], form["reverse"], form["form"], form["end"], form["index"], form["seed"]
    if found != (*race.kind, race.index, race.seed):
        raise ConfigError(
            f"race {race.number} of the benchmark result is {found}, expected "
            f"{(*race.kind, race.index, race.seed)}; another version of stkzoo wrote it"
        )
    return RaceOutcome.from_form(form, race, plan.ai_time(race.track, race.reverse), plan.limit)
