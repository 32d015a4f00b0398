"""One race of a batch."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Protocol

from stkzoo.race.settings import RaceSettings

__all__ = ["NAME_MARK", "Order", "RaceOrder"]

#: Stands before a driver's name in its text.
NAME_MARK = "@:"


class Order(Protocol):
    """What a process can be asked to run.

    Attributes:
        worker: the module that runs it, see :mod:`stkzoo.evaluation.batch.worker`.
    """

    worker: ClassVar[str]

    @property
    def number(self) -> int:
        """Counts the orders of a batch, from 0."""

    def to_form(self) -> dict[str, Any]:
        """What the process needs to know, as what JSON can hold."""


@dataclass(frozen=True, slots=True)
class RaceOrder:
    """A race that is to be run.

    Attributes:
        number: counts the races of the batch, from 0.
        drivers: texts for :func:`~stkzoo.race.find_driver`, first place of the grid first.
        settings: of the race, with its track and seed.
        wait_for: see :func:`~stkzoo.race.run_race`.
    """

    number: int
    drivers: tuple[str, ...]
    settings: RaceSettings
    wait_for: tuple[int, ...] | None = None
    worker: ClassVar[str] = "stkzoo.evaluation.batch.worker"

    @property
    def labels(self) -> list[str]:
        """What the drivers are called, in the same order; each needs a name in its text."""
        return [text.rpartition(NAME_MARK)[2] for text in self.drivers]

    def to_form(self) -> dict[str, Any]:
        """What the process that runs it needs to know."""
        return {
            "drivers": self.drivers,
            "settings": asdict(self.settings),
            "wait_for": self.wait_for,
        }
