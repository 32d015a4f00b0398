"""One race of a batch, as a worker process runs it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Generic, TypeVar

from stkzoo._os import write_text
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.entrants import NAME_MARK
from stkzoo.race.result import RaceResult
from stkzoo.race.runner import run_race
from stkzoo.race.settings import RaceSettings

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class BatchOrder(ABC, Generic[Result]):
    """A race to run, and where its result is stored.

    Attributes:
        number: counts the races of the batch, from 0.
        drivers: texts for :func:`~stkzoo.race.find_driver`, one per kart.
        settings: of the race, with its track and seed.
        wait_for: see :func:`~stkzoo.race.run_race`.
    """

    number: int
    drivers: tuple[str, ...]
    settings: RaceSettings
    wait_for: tuple[int, ...] | None = None

    @abstractmethod
    def run(self) -> str:
        """Runs the race, in a worker process, and returns its ``RaceResult`` as JSON."""

    @abstractmethod
    def load(self, folder: Path) -> Result | None:
        """The stored result; ``None`` if the race has not been run.

        Raises:
            ConfigError: the file is damaged or belongs to another race.
        """

    @abstractmethod
    def store(self, folder: Path, text: str) -> Result:
        """Stores what :meth:`run` returned.

        Raises:
            ConfigError: the file cannot be written.
        """


@dataclass(frozen=True, slots=True)
class RaceOrder(BatchOrder[RaceResult]):
    """A race whose drivers have fixed start positions: the first driver starts in front."""

    @property
    def labels(self) -> list[str]:
        """The drivers' names, in the same order; each text ends with one."""
        return [text.rpartition(NAME_MARK)[2] for text in self.drivers]

    def run(self) -> str:
        """Runs the race."""
        result = run_race(
            list(self.drivers),
            start_positions=range(1, len(self.drivers) + 1),
            wait_for=self.wait_for,
            settings=self.settings,
        )
        return result.to_json()

    def load(self, folder: Path) -> RaceResult | None:
        """The stored result."""
        file = self._file(folder)
        try:
            result = RaceResult.from_json(file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"{file} cannot be read: {error}; delete it to run the race again"
            ) from error
        if not self._matches(result):
            raise ConfigError(
                f"{file} belongs to another race than the plan's; delete it to run the race again"
            )
        return result

    def store(self, folder: Path, text: str) -> RaceResult:
        """Stores the result, atomically."""
        write_text(self._file(folder), text + "\n")
        return RaceResult.from_json(text)

    def _file(self, folder: Path) -> Path:
        return folder / "races" / f"{self.number:05d}.json"

    def _matches(self, result: RaceResult) -> bool:
        settings = asdict(self.settings)
        grid = [row.driver for row in sorted(result.agents, key=lambda row: row.start_position)]
        return grid == self.labels and all(
            getattr(result, name) == settings[name]
            for name in ("seed", "track", "reverse", "difficulty")
        )


def load_orders(orders: Sequence[BatchOrder[Result]], folder: Path) -> dict[int, Result]:
    """The stored results of a batch, by number.

    Raises:
        ConfigError: a file is damaged or belongs to another race.
    """
    stored = {order.number: order.load(folder) for order in orders}
    return {number: result for number, result in stored.items() if result is not None}
