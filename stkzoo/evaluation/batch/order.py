"""Orders: the description of one race of a batch, which a worker process runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stkzoo._os import write_text
from stkzoo.drivers.driver import Driver
from stkzoo.errors import ConfigError
from stkzoo.race.listeners import RaceListener
from stkzoo.race.result import RaceResult
from stkzoo.race.runner import run_race
from stkzoo.race.settings import RaceSettings

#: Names of the folders of races and of their replays in a batch's folder.
RACES, REPLAYS = "races", "replays"


@dataclass(frozen=True, slots=True)
class RaceOrder:
    """A race to run. Its drivers have fixed start positions: the first driver starts in front.

    Attributes:
        number: number of the race in the batch, from 0.
        drivers: texts for :func:`~stkzoo.race.find_driver`, one per kart.
        settings: settings of the race, with its track and seed.
        wait_for: see :func:`~stkzoo.race.run_race`.
    """

    number: int
    drivers: tuple[str, ...]
    settings: RaceSettings
    wait_for: tuple[int, ...] | None = None

    def run(self, folder: Path) -> RaceResult:  # noqa: ARG002 - orders may write more files
        """Runs the race. A worker process calls this.

        Args:
            folder: folder of the batch.
        """
        return self.race(self.drivers)

    def race(
        self, drivers: Sequence[str | Driver], listeners: Sequence[RaceListener] = ()
    ) -> RaceResult:
        """Runs the race with drivers and listeners.

        Args:
            drivers: the order's drivers, perhaps already found.
            listeners: listeners of the race.
        """
        return run_race(
            drivers,
            listeners=listeners,
            start_positions=range(1, len(drivers) + 1),
            wait_for=self.wait_for,
            settings=self.settings,
        )

    def hurried(self, race_timeout: float) -> RaceOrder:
        """Returns the race with a time budget, so that slow agents cannot make it late.

        Each agent gets the same share of the time limit, and the game gets one too. All agents run
        in processes of their own, which can be stopped.

        Args:
            race_timeout: time limit of the race [s].
        """
        share = race_timeout / (len(self.drivers) + 1)
        budget = min(share, self.settings.time_budget or share)
        return replace(self, settings=replace(self.settings, inline=False, time_budget=budget))

    def load(self, folder: Path) -> RaceResult | None:
        """Returns the stored result; ``None`` if the race has not been run.

        Args:
            folder: folder of the batch.

        Raises:
            ConfigError: the file is damaged.
        """
        file = self.file(folder)
        if not file.exists():
            return None
        try:
            return RaceResult.load(file)
        except ConfigError as error:
            raise ConfigError(f"{error}; delete it to run the race again") from error

    def store(self, folder: Path, result: RaceResult) -> None:
        """Stores the result of the race, atomically.

        Args:
            folder: folder of the batch.
            result: the result.

        Raises:
            ConfigError: the file cannot be written.
        """
        write_text(self.file(folder), result.to_json() + "\n")

    def file(self, folder: Path, ending: str = ".json") -> Path:
        """Returns the file of the race's result, or of other data about the race beside it.

        Args:
            folder: folder of the batch.
            ending: suffix of the file.
        """
        return folder / RACES / f"{self.number:05d}{ending}"


def replay_file(folder: Path, number: int) -> Path:
    """Returns the file of the replay of a batch's race, which some batches store.

    Args:
        folder: folder of the batch.
        number: number of the race.
    """
    return folder / REPLAYS / f"{number:05d}.stkz"


def load_orders(orders: Sequence[RaceOrder], folder: Path) -> dict[int, RaceResult]:
    """Returns the stored results of a batch, by number of the race.

    Args:
        orders: all races of the batch.
        folder: folder of the batch.

    Raises:
        ConfigError: a file is damaged.
    """
    stored = {order.number: order.load(folder) for order in orders}
    return {number: result for number, result in stored.items() if result is not None}
