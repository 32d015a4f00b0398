"""The races of a benchmark, their outcomes for the agent, and metrics over groups of races."""

from __future__ import annotations

import hashlib
import itertools
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np

from stkzoo._schema import Count, Place, Positive, one_of
from stkzoo.errors import ConfigError
from stkzoo.evaluation.statistics import Estimate, estimate_clustered, estimate_mean
from stkzoo.race.result import AgentResult, RaceResult

#: The race forms of the benchmark protocol.
FORMS = ("PAAAA", "PPAAA", "P")
_FORM = re.compile(r"(P+)(A*|B*)")
_MAX_KARTS = 20
_SEED_BYTES = 4

#: Ends of the grid.
FRONT, BACK = "front", "back"
_STEP, _COUNTDOWN = 0.1, 20  # step size [s], and number of steps before the race clock starts


@dataclass(frozen=True, slots=True)
class BenchmarkForm:
    """A race form: the numbers of karts of the agent and of its rivals.

    Attributes:
        name: name of the form; ``"PPAAA"`` means two karts of the agent and three of the game's AI.
            The letter B instead of A stands for drivers of a population (:mod:`stkzoo.suite`).
        agents: number of karts of the agent.
        rivals: number of other karts.
    """

    name: str
    agents: int
    rivals: int

    @classmethod
    def of(cls, name: str) -> BenchmarkForm:
        """Returns the form with a name.

        Args:
            name: one or more letters P, then any number of letters A; at most 20 letters.

        Raises:
            ConfigError: the name is invalid.
        """
        match = _FORM.fullmatch(name) if isinstance(name, str) else None
        if match is None or len(name) > _MAX_KARTS:
            raise ConfigError(
                f"race form {name!r} is unknown; expected P for each kart of the agent, then A for "
                f"each of the game's AI, such as PAAAA, at most {_MAX_KARTS} together"
            )
        return cls(name, len(match[1]), len(match[2]))

    @property
    def ends(self) -> tuple[str, ...]:
        """The ends of the grid from which the agent starts; only the front without rivals."""
        return (FRONT, BACK) if self.rivals else (FRONT,)

    @property
    def has_population(self) -> bool:
        """Whether the rivals are drivers of a population."""
        return self.name.endswith("B")

    @property
    def chance(self) -> float:
        """Fraction of races that the agent would win if all drivers were equally good."""
        return self.agents / (self.agents + self.rivals)

    def agent_karts(self, end: str) -> tuple[int, ...]:
        """Returns the numbers of the agent's karts in grid order; 0 is in front.

        Args:
            end: the end of the grid from which the agent starts.
        """
        first = 0 if end == FRONT else self.rivals
        return tuple(range(first, first + self.agents))


@dataclass(frozen=True, slots=True)
class BenchmarkRace:
    """One race of a benchmark.

    Attributes:
        number: number of the race, from 0.
        track: name of the track.
        reverse: whether the race is in reverse.
        form: name of the race form, such as ``"PPAAA"``.
        end: the end of the grid from which the agent starts: ``"front"`` or ``"back"``.
        index: number of the race among those that differ only in their seeds, from 0.
        seed: seed of all random choices in the race; the same for every agent.
    """

    number: Count
    track: str
    reverse: bool
    form: str
    end: Annotated[str, one_of(FRONT, BACK)]
    index: Count
    seed: Count

    @property
    def lineup(self) -> BenchmarkForm:
        """The race form."""
        return BenchmarkForm.of(self.form)

    @property
    def stratum(self) -> tuple[str, bool, str, str]:
        """Track, ``reverse``, form and end. Races that differ only in their seeds share these."""
        return self.track, self.reverse, self.form, self.end

    @property
    def key(self) -> tuple[str, bool, str, str, int]:
        """:attr:`stratum` and index, which identify the race in all benchmarks."""
        return *self.stratum, self.index


def race_seed(track: str, reverse: bool, form: str, end: str, index: int) -> int:
    """Returns the seed of a race: a digest of its key, independent of the agent.

    Args:
        track: name of the track.
        reverse: whether the race is in reverse.
        form: name of the race form.
        end: the end of the grid from which the agent starts.
        index: number of the race among those that differ only in their seeds.
    """
    text = "/".join((track, direction_name(reverse), form, end, str(index)))
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=_SEED_BYTES).digest(), "big")


def direction_name(reverse: bool) -> str:
    """Returns the name of a direction: ``"forward"`` or ``"reversed"``."""
    return "reversed" if reverse else "forward"


def steps_within(seconds: float) -> int:
    """Returns the number of steps of a race that lasts for a time.

    Args:
        seconds: time on the race clock [s].
    """
    return math.ceil(seconds / _STEP) + _COUNTDOWN


def make_races(
    tracks: Sequence[str], directions: Sequence[bool], forms: Sequence[BenchmarkForm], seeds: int
) -> tuple[BenchmarkRace, ...]:
    """Returns all races, ordered by index first, so that an interrupted benchmark is balanced.

    Args:
        tracks: the tracks.
        directions: ``False`` for forward, ``True`` for reversed.
        forms: the race forms.
        seeds: number of races for each track, direction, form and end of the grid.
    """
    strata = [
        (track, reverse, form.name, end)
        for track, reverse, form in itertools.product(tracks, directions, forms)
        for end in form.ends
    ]
    return tuple(
        BenchmarkRace(number, *stratum, index, race_seed(*stratum, index))
        for number, (index, stratum) in enumerate(itertools.product(range(seeds), strata))
    )


@dataclass(frozen=True, slots=True)
class KartOutcome:
    """The outcome of one kart of the agent.

    Attributes:
        time: finish time [s]; ``None`` if the kart did not finish.
        rank: rank; karts of the agent that did not finish have the last ranks.
        rescues: number of times the kart was put back on the road; ``None`` if not counted.
        errors: number of failures of the agent.
    """

    time: Positive | None
    rank: Place
    rescues: Count | None
    errors: Count


@dataclass(frozen=True, slots=True)
class RaceOutcome(BenchmarkRace):
    """One race and its outcome for the agent.

    Attributes:
        status: why the race ended.
        time_ratio: mean finish time of the agent's karts as a multiple of the AI's median time (in
            time trials, of the human record), at most the time limit. A kart that did not finish
            counts with the time limit.
        karts: outcomes of the agent's karts in grid order.
    """

    status: str
    time_ratio: Positive
    karts: tuple[KartOutcome, ...]

    def __post_init__(self) -> None:
        if len(self.karts) != self.lineup.agents:
            raise ConfigError(f"{len(self.karts)} karts, expected {self.lineup.agents}")

    @classmethod
    def of(
        cls, race: BenchmarkRace, result: RaceResult, reference_time: float, limit: float
    ) -> RaceOutcome:
        """Returns the outcome of a race for the agent.

        Args:
            race: the race.
            result: result of the race.
            reference_time: the time with which the agent's is compared [s].
            limit: time limit of the race, as a multiple of ``reference_time``.
        """
        numbers = race.lineup.agent_karts(race.end)
        rows = [row for row in result.agents if row.start_position - 1 in numbers]
        lost = [row.agent for row in rows if row.finish_time is None]
        last = dict(zip(reversed(lost), range(len(result.agents), 0, -1), strict=False))
        rows.sort(key=lambda row: row.start_position)
        karts = tuple(_kart(row, last.get(row.agent, row.rank)) for row in rows)
        ratios = [limit if k.time is None else min(k.time / reference_time, limit) for k in karts]
        return cls(**asdict(race), status=result.status, time_ratio=_mean(ratios), karts=karts)

    @property
    def errors(self) -> int:
        """Number of failures of the agent."""
        return sum(kart.errors for kart in self.karts)

    @property
    def is_won(self) -> float | None:
        """1 if a kart of the agent won, otherwise 0; ``None`` without rivals."""
        if not self.lineup.rivals:
            return None
        return float(any(kart.rank == 1 and kart.time is not None for kart in self.karts))

    @property
    def beaten(self) -> float | None:
        """Mean share of rivals behind a kart of the agent; ``None`` without rivals.

        A kart of the agent that did not finish has beaten nobody.
        """
        rivals = self.lineup.rivals
        if not rivals:
            return None
        taken = {kart.rank for kart in self.karts}
        others = [rank for rank in range(1, len(self.form) + 1) if rank not in taken]
        shares = [
            0.0 if kart.time is None else sum(rank > kart.rank for rank in others) / rivals
            for kart in self.karts
        ]
        return _mean(shares)

    @property
    def rank(self) -> float | None:
        """Mean rank of the agent's karts; ``None`` without rivals."""
        return _mean([kart.rank for kart in self.karts]) if self.lineup.rivals else None

    @property
    def unfinished(self) -> float:
        """Fraction of the agent's karts that did not finish."""
        return _mean([kart.time is None for kart in self.karts])

    @property
    def rescues(self) -> float | None:
        """Mean number of rescues of the agent's karts; ``None`` if not counted for all of them."""
        counts = [kart.rescues for kart in self.karts if kart.rescues is not None]
        return _mean(counts) if len(counts) == len(self.karts) else None


def _kart(row: AgentResult, rank: int) -> KartOutcome:
    time = None if row.finish_time is None else round(row.finish_time, 4)
    return KartOutcome(time, rank, row.rescues, row.num_errors)


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


@dataclass(frozen=True, slots=True)
class FigureKind:
    """A metric of a race.

    Attributes:
        name: name of the metric.
        of: function that returns its value in one race, or ``None`` if it is undefined.
        bounds: lowest and highest possible value, for fractions and counts.
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

_GROUPINGS: dict[str, Callable[[BenchmarkRace], str]] = {
    "all": lambda _: "",
    "form": lambda race: race.form,
    "direction": lambda race: direction_name(race.reverse),
    "end": lambda race: race.end if race.lineup.rivals else "alone",
    "track": lambda race: race.track,
    "track and direction": lambda race: f"{race.track} {direction_name(race.reverse)}",
}


@dataclass(frozen=True, slots=True)
class RaceGroup:
    """A group of races and its metrics.

    Attributes:
        by: what the races have in common: ``"all"``, ``"form"``, ``"direction"``, ``"end"``,
            ``"track"`` or ``"track and direction"``.
        name: name of the group, such as that of the track; empty for all races.
        races: number of races.
        chance: fraction of races that the agent would win if all drivers were equally good;
            ``None`` without rivals.
        figures: estimates of the metrics by name, as in :data:`FIGURES`; ``None`` for a metric
            that no race has.
        clustered: the same means with intervals over clusters: the track and direction of a race.
    """

    by: str
    name: str
    races: int
    chance: float | None
    figures: Mapping[str, Estimate | None]
    clustered: Mapping[str, Estimate | None]

    @classmethod
    def all_of(
        cls, outcomes: Sequence[RaceOutcome], metrics: Sequence[FigureKind]
    ) -> tuple[RaceGroup, ...]:
        """Returns the metrics of all races and of groups of races, in display order.

        Args:
            outcomes: the races.
            metrics: the metrics.
        """
        groups: dict[tuple[str, str], list[RaceOutcome]] = {}
        for by, name_of in _GROUPINGS.items():
            for outcome in outcomes:
                groups.setdefault((by, name_of(outcome)), []).append(outcome)
        return tuple(_group(by, name, members, metrics) for (by, name), members in groups.items())

    @classmethod
    def find(cls, groups: Iterable[RaceGroup], by: str, name: str) -> RaceGroup:
        """Returns one of several groups.

        Args:
            groups: the groups.
            by: what the races have in common.
            name: name of the group.

        Raises:
            KeyError: there is no such group.
        """
        return {(group.by, group.name): group for group in groups}[by, name]


def _group(
    by: str, name: str, outcomes: Sequence[RaceOutcome], metrics: Sequence[FigureKind]
) -> RaceGroup:
    strata = [outcome.stratum for outcome in outcomes]
    chances = [outcome.lineup.chance for outcome in outcomes if outcome.lineup.rivals]
    figures = {
        metric.name: estimate_mean(
            [metric.of(outcome) for outcome in outcomes], strata, metric.bounds
        )
        for metric in metrics
    }
    clustered = {metric.name: _clustered(outcomes, metric) for metric in metrics}
    chance = _mean(chances) if chances else None
    return RaceGroup(by, name, len(outcomes), chance, figures, clustered)


def _clustered(outcomes: Sequence[RaceOutcome], metric: FigureKind) -> Estimate | None:
    """Returns the estimate of a metric with an interval over tracks and directions."""
    numbers: dict[tuple[str, bool], int] = {}
    for outcome in outcomes:
        numbers.setdefault((outcome.track, outcome.reverse), len(numbers))
    totals, counts = np.zeros((2, len(numbers)))
    for outcome in outcomes:
        value, number = metric.of(outcome), numbers[outcome.track, outcome.reverse]
        if value is not None:
            totals[number] += value
            counts[number] += 1
    return estimate_clustered(totals, counts)
