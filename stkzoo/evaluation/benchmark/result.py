"""The result of a benchmark: every race's outcome, and figures over groups of races."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from stkzoo.errors import ConfigError
from stkzoo.evaluation.benchmark.plan import BenchmarkPlan
from stkzoo.evaluation.benchmark.races import BenchmarkRace, direction_name
from stkzoo.evaluation.statistics import CONFIDENCE, Estimate, estimate_known
from stkzoo.race.result import (
    AgentResult,
    RaceResult,
    json_with_rows,
    read_document,
    reading,
)

#: Of the JSON file (``docs/schemas/benchmark-result.schema.json``).
SCHEMA_VERSION = 1
_TYPE = "benchmark-result"


@dataclass(frozen=True, slots=True)
class KartOutcome:
    """The outcome of one kart of the agent.

    Attributes:
        time: its finish time [s]; ``None`` if it did not finish.
        rank: its rank; karts of the agent that did not finish have the last ranks.
        rescues: how often it was put back on the road; ``None`` if not counted.
        errors: how often the agent failed.
    """

    time: float | None
    rank: int
    rescues: int | None
    errors: int


@dataclass(frozen=True, slots=True)
class RaceOutcome:
    """The outcome of one race for the agent.

    Attributes:
        race: the race.
        status: why it ended.
        ai_time: the AI's median time there [s].
        limit: the multiple of it after which the race ended.
        karts: the agent's, in the order of the grid.
    """

    race: BenchmarkRace
    status: str
    ai_time: float
    limit: float
    karts: tuple[KartOutcome, ...]

    @classmethod
    def of(
        cls, race: BenchmarkRace, result: RaceResult, ai_time: float, limit: float
    ) -> RaceOutcome:
        """The agent's part of a race's result."""
        places = race.form.places(race.end)
        own = [row for row in result.agents if row.start_position - 1 in places]
        lost = [row.agent for row in own if row.finish_time is None]
        last = dict(zip(reversed(lost), range(len(result.agents), 0, -1), strict=False))
        own.sort(key=lambda row: row.start_position)
        karts = tuple(_kart(row, last.get(row.agent, row.rank)) for row in own)
        return cls(race, result.status, ai_time, limit, karts)

    @property
    def time_ratio(self) -> float:
        """The karts' mean finish time as a multiple of the AI's; at most ``limit``.

        A kart that did not finish counts with the limit.
        """
        return _mean([self._ratio(kart) for kart in self.karts])

    @property
    def is_won(self) -> float | None:
        """1 if a kart of the agent won, else 0; ``None`` without rivals."""
        if not self.race.form.rivals:
            return None
        return float(any(kart.rank == 1 and kart.time is not None for kart in self.karts))

    @property
    def rank(self) -> float | None:
        """The karts' mean rank; ``None`` without rivals."""
        return _mean([kart.rank for kart in self.karts]) if self.race.form.rivals else None

    @property
    def unfinished(self) -> float:
        """The share of karts that did not finish."""
        return _mean([kart.time is None for kart in self.karts])

    @property
    def rescues(self) -> float | None:
        """How often each kart was put back on the road; ``None`` if not counted."""
        counts = [kart.rescues for kart in self.karts if kart.rescues is not None]
        return _mean(counts) if len(counts) == len(self.karts) else None

    def _ratio(self, kart: KartOutcome) -> float:
        return self.limit if kart.time is None else min(kart.time / self.ai_time, self.limit)

    def to_dict(self) -> dict[str, Any]:
        """The outcome as JSON values; the rest follows from the plan."""
        return {
            "number": self.race.number,
            "track": self.race.track,
            "reverse": self.race.reverse,
            "form": self.race.form.name,
            "end": self.race.end,
            "index": self.race.index,
            "seed": self.race.seed,
            "status": self.status,
            "time_ratio": round(self.time_ratio, 5),
            "karts": [asdict(kart) for kart in self.karts],
        }

    @classmethod
    def from_dict(
        cls, values: Mapping[str, Any], race: BenchmarkRace, ai_time: float, limit: float
    ) -> RaceOutcome:
        """Reads the output of :meth:`to_dict`."""
        karts = tuple(KartOutcome(**kart) for kart in values["karts"])
        return cls(race, values["status"], ai_time, limit, karts)


def _kart(row: AgentResult, rank: int) -> KartOutcome:
    time = None if row.finish_time is None else round(row.finish_time, 4)
    return KartOutcome(time, rank, row.rescues, row.num_errors)


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


@dataclass(frozen=True, slots=True)
class FigureKind:
    """A kind of figure.

    Attributes:
        name: its name.
        of: its value in one race; ``None`` where undefined.
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
class RaceGroup:
    """A group of races and its figures.

    Attributes:
        by: what they have in common: ``"all"``, ``"form"``, ``"direction"``, ``"end"``,
            ``"track"`` or ``"track and direction"``.
        name: which of these; empty for all.
        races: how many.
        chance: the share that the agent would win if all drivers were equally good; ``None``
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
    """The result of a benchmark.

    Attributes:
        plan: the benchmark.
        outcomes: the races that have been run.
    """

    plan: BenchmarkPlan
    outcomes: tuple[RaceOutcome, ...]

    @property
    def label(self) -> str:
        """The agent's name."""
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
    def groups(self) -> tuple[RaceGroup, ...]:
        """The figures, over all races and over parts of them."""
        return tuple(
            RaceGroup(by, name, len(members), _chance(members), _figures(members))
            for (by, name), members in groups_of(self.outcomes).items()
        )

    def group(self, by: str = "all", name: str = "") -> RaceGroup:
        """The figures of some races.

        Raises:
            KeyError: there are no such races.
        """
        return {(group.by, group.name): group for group in self.groups}[by, name]

    def to_json(self) -> str:
        """The result as JSON (``docs/schemas/benchmark-result.schema.json``)."""
        head = {
            "type": _TYPE,
            "schema_version": SCHEMA_VERSION,
            "agent": self.label,
            "is_complete": self.is_complete,
            "interval": {"kind": "bootstrap over races", "confidence": CONFIDENCE},
            "groups": [asdict(group) for group in self.groups],
            "plan": self.plan.to_dict(),
        }
        return json_with_rows(head, "races", [outcome.to_dict() for outcome in self.outcomes])

    @classmethod
    def from_json(cls, text: str) -> BenchmarkResult:
        """Reads the output of :meth:`to_json`.

        Raises:
            ConfigError: the text is something else, or has another version.
        """
        with reading("the text is no benchmark result", "the result.json of `stkzoo benchmark`"):
            values = read_document(text, _TYPE, SCHEMA_VERSION)
            plan = BenchmarkPlan.from_dict(values["plan"])
            races = {race.number: race for race in plan.races()}
            outcomes = [_outcome(entry, races[entry["number"]], plan) for entry in values["races"]]
            return cls(plan, tuple(outcomes))


def benchmark_result(plan: BenchmarkPlan, results: Mapping[int, RaceResult]) -> BenchmarkResult:
    """Summarizes the races that have been run.

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
    """The races by what they have in common, in display order."""
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
    strata = [outcome.race.kind for outcome in outcomes]
    return {
        kind.name: estimate_known([kind.of(race) for race in outcomes], strata, kind.bounds)
        for kind in FIGURES
    }


def _outcome(values: Mapping[str, Any], race: BenchmarkRace, plan: BenchmarkPlan) -> RaceOutcome:
    names = ("track", "reverse", "form", "end", "index", "seed")
    found = tuple(values[name] for name in names)
    if found != (*race.kind, race.index, race.seed):
        raise ConfigError(
            f"race {race.number} of the benchmark result is {found}, expected "
            f"{(*race.kind, race.index, race.seed)}; another version of stkzoo wrote it"
        )
    return RaceOutcome.from_dict(values, race, plan.ai_time(race.track, race.reverse), plan.limit)
