"""Orders: the description of one race of a batch, which a worker process runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import NoReturn

from stkzoo._os import write_text
from stkzoo.drivers.driver import Driver, find_driver
from stkzoo.drivers.instances import DriverRequest
from stkzoo.errors import AgentError, ConfigError
from stkzoo.evaluation.batch.entrants import NAME_MARK
from stkzoo.race.document import Document
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
        absent: indices of drivers that do not start. They fail, and their karts stand still.
    """

    number: int
    drivers: tuple[str, ...]
    settings: RaceSettings
    wait_for: tuple[int, ...] | None = None
    absent: tuple[int, ...] = field(default=(), kw_only=True)

    def run(self, folder: Path) -> Document:  # noqa: ARG002 - orders may write more files
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
            drivers: the order's drivers, perhaps in another form; those that are absent fail.
            listeners: listeners of the race.
        """
        return run_race(
            self.without_absent(drivers),
            listeners=listeners,
            start_positions=range(1, len(drivers) + 1),
            wait_for=self.wait_for,
            settings=self.settings,
        )

    def suspects(self) -> tuple[int, ...]:
        """Returns the indices of drivers whose code may have ended the process of the race.

        These are the drivers from files.
        """
        return tuple(
            number for number, text in enumerate(self.drivers) if find_driver(text).is_from_files
        )

    def isolated(self) -> RaceOrder:
        """Returns the same race with each agent in its own process, sandboxed if possible.

        If the settings require a sandbox, the race still requires it.
        """
        sandbox = "on" if self.settings.sandbox == "on" else "auto"
        return replace(self, settings=replace(self.settings, inline=False, sandbox=sandbox))

    def hurried(self, race_timeout: float) -> RaceOrder:
        """Returns the isolated race with a time budget, so that slow agents cannot make it late.

        Each agent gets the same share of the time limit, and the game gets one too.

        Args:
            race_timeout: time limit of the race [s].
        """
        isolated = self.isolated()
        share = race_timeout / (len(self.drivers) + 1)
        budget = min(share, self.settings.time_budget or share)
        return replace(isolated, settings=replace(isolated.settings, time_budget=budget))

    def without_absent(self, drivers: Sequence[str | Driver]) -> list[str | Driver]:
        """Returns the drivers; those that are absent fail when they start.

        Args:
            drivers: the drivers of the race.
        """
        return [
            _absent(driver) if number in self.absent else driver
            for number, driver in enumerate(drivers)
        ]

    def load(self, folder: Path) -> RaceResult | None:
        """Returns the stored result; ``None`` if the race has not been run.

        Args:
            folder: folder of the batch.

        Raises:
            ConfigError: the file is damaged or belongs to another race.
        """
        file = self.file(folder)
        if not file.exists():
            return None
        try:
            result = RaceResult.load(file)
        except ConfigError as error:
            raise ConfigError(f"{error}; delete it to run the race again") from error
        if not self._matches(result):
            raise ConfigError(
                f"{file} belongs to another race than the plan's; delete it to run the race again"
            )
        return result

    def store(self, folder: Path, text: str) -> RaceResult:
        """Stores the result of the race, atomically.

        Args:
            folder: folder of the batch.
            text: the result as JSON.

        Returns:
            The result.

        Raises:
            ConfigError: the text is not a result, or the file cannot be written.
        """
        result = RaceResult.from_json(text)
        write_text(self.file(folder), text + "\n")
        return result

    def file(self, folder: Path, ending: str = ".json") -> Path:
        """Returns the file of the race's result, or of other data about the race beside it.

        Args:
            folder: folder of the batch.
            ending: suffix of the file.
        """
        return folder / RACES / f"{self.number:05d}{ending}"

    def replay_file(self, folder: Path) -> Path:
        """Returns the file of the race's replay, which some batches store.

        Args:
            folder: folder of the batch.
        """
        return replay_file(folder, self.number)

    def _matches(self, result: RaceResult) -> bool:
        rows = sorted(result.agents, key=lambda row: (len(row.agent), row.agent))
        found = [
            f"{row.source}{NAME_MARK}{row.driver}" if NAME_MARK in text else row.source
            for row, text in zip(rows, self.drivers, strict=False)
        ]
        # An agent keeps its name when its folder is moved.
        return [*map(_last_part, found)] == [*map(_last_part, self.drivers)] and all(
            getattr(result, name) == getattr(self.settings, name)
            for name in ("seed", "track", "reverse", "mode", "laps", "difficulty")
        )


def _last_part(driver: str) -> str:
    source, mark, label = driver.partition(NAME_MARK)
    return f"{PurePath(source).name}{mark}{label}"


def replay_file(folder: Path, number: int) -> Path:
    """Returns the file of the replay of a batch's race.

    Args:
        folder: folder of the batch.
        number: number of the race.
    """
    return folder / REPLAYS / f"{number:05d}.stkz"


def _absent(driver: str | Driver) -> Driver:
    known = find_driver(driver) if isinstance(driver, str) else driver
    return replace(known, start=_refuse)


def _refuse(request: DriverRequest) -> NoReturn:
    raise AgentError("its code ended the race's process", request.agent)


def load_orders(orders: Sequence[RaceOrder], folder: Path) -> dict[int, RaceResult]:
    """Returns the stored results of a batch, by number of the race.

    Args:
        orders: all races of the batch.
        folder: folder of the batch.

    Raises:
        ConfigError: a file is damaged or belongs to another race.
    """
    stored = {order.number: order.load(folder) for order in orders}
    return {number: result for number, result in stored.items() if result is not None}
