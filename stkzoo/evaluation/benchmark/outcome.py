"""What one race of a benchmark came to for the agent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from stkzoo.evaluation.benchmark.races import BenchmarkRace
from stkzoo.race.result import AgentResult, RaceResult

__all__ = ["KartOutcome", "RaceOutcome"]


@dataclass(frozen=True, slots=True)
class KartOutcome:
    """How one kart of the agent did.

    Attributes:
        time: its finish time [s]; ``None`` if it did not finish.
        rank: its place; karts of the agent that did not finish have the last places.
        rescues: how often it was put back on the road; ``None`` if that was not counted.
        errors: how often the agent failed.
    """

    time: float | None
    rank: int
    rescues: int | None
    errors: int


@dataclass(frozen=True, slots=True)
class RaceOutcome:
    """What one race came to for the agent.

    Attributes:
        race: which.
        status: why it was over.
        ai_time: the AI's median time there [s].
        limit: after this multiple of it the race was over.
        karts: the agent's, first place of the grid first.
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
        """Takes the agent's part from a race's result."""
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

        A kart that did not finish counts as one that needed the whole limit.
        """
        return _mean([self._ratio(kart) for kart in self.karts])

    @property
    def is_won(self) -> float | None:
        """1 if a kart of the agent came in first, else 0; ``None`` without rivals."""
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
        """How often each kart was put back on the road; ``None`` if that was not counted."""
        counts = [kart.rescues for kart in self.karts if kart.rescues is not None]
        return _mean(counts) if len(counts) == len(self.karts) else None

    def _ratio(self, kart: KartOutcome) -> float:
        return self.limit if kart.time is None else min(kart.time / self.ai_time, self.limit)

    def to_form(self) -> dict[str, Any]:
        """The outcome as what JSON can hold; the rest follows from the plan."""
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
    def from_form(
        cls, form: Mapping[str, Any], race: BenchmarkRace, ai_time: float, limit: float
    ) -> RaceOutcome:
        """Reads what :meth:`to_form` gave."""
        karts = tuple(KartOutcome(**kart) for kart in form["karts"])
        return cls(race, form["status"], ai_time, limit, karts)


def _kart(row: AgentResult, rank: int) -> KartOutcome:
    time = None if row.finish_time is None else round(row.finish_time, 4)
    return KartOutcome(time, rank, row.rescues, row.num_errors)


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)
