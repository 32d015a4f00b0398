"""The folder of a batch: its plan, and one file for each race that has been run.

A race's file is written beside, flushed to the disk and put in its place in one step. So
whatever ends the program, a race is there whole or not at all.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Generic, Protocol, TypeVar

from stkzoo._os import PART_FILES, atomic_write
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.order import Order, RaceOrder
from stkzoo.race.result import RaceResult

__all__ = ["BatchFolder", "BatchKind", "BatchPlan", "read_races", "write_whole"]

_PLAN, _RACES, _LOCK = "plan.json", "races", "lock"


class BatchPlan(Protocol):
    """What a batch is to be."""

    def to_json(self) -> str:
        """The plan as JSON."""

    def differences(self, other: Any, /) -> list[str]:
        """What another plan of the same kind has otherwise, in words."""


Plan = TypeVar("Plan", bound=BatchPlan)


@dataclass(frozen=True, slots=True)
class BatchKind(Generic[Plan]):
    """A kind of batch.

    Attributes:
        noun: what such a batch is called.
        from_json: reads its plan.
        go_on: how to go on with one in ``{folder}``, for messages.
    """

    noun: str
    from_json: Callable[[str], Plan]
    go_on: str

    def read_plan(self, folder: Path) -> Plan:
        """The plan of the batch in a folder.

        Raises:
            ConfigError: there is none, or it cannot be read.
        """
        try:
            return self.from_json((folder / _PLAN).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(
                f"{folder} has no {self.noun} ({error}); expected the --output of one"
            ) from error


class BatchFolder(Generic[Plan]):
    """The folder of one batch. A context manager: nobody else has it meanwhile.

    Args:
        kind: what kind of batch.
        folder: where; it is made if there is none.

    Raises:
        ConfigError: it cannot be made, or another program runs this batch.
    """

    def __init__(self, kind: BatchKind[Plan], folder: str | os.PathLike[str]) -> None:
        self.path, self._kind = Path(folder), kind
        try:
            (self.path / _RACES).mkdir(parents=True, exist_ok=True)
            self._lock = (self.path / _LOCK).open("a")
        except OSError as error:
            raise ConfigError(
                f"the {kind.noun}'s folder {self.path} cannot be used: {error}"
            ) from error
        if not _take(self._lock):
            self._lock.close()
            raise ConfigError(
                f"another program runs the {kind.noun} in {self.path}; wait for its end, or "
                "choose another folder"
            )
        for place in (self.path, self.path / _RACES):
            for part in place.glob(PART_FILES):  # of a program that was killed while it wrote
                part.unlink(missing_ok=True)

    def __enter__(self) -> BatchFolder[Plan]:
        return self

    def __exit__(self, *exception: object) -> None:
        self._lock.close()

    def keep_plan(self, plan: Plan) -> Plan:
        """Writes the plan, or checks that it is the one that was begun here.

        Returns:
            The plan as it was begun.

        Raises:
            ConfigError: another batch was begun in this folder.
        """
        file = self.path / _PLAN
        if not file.exists():
            write_whole(file, plan.to_json() + "\n")
            return plan
        begun = self._kind.read_plan(self.path)
        differences = begun.differences(plan)
        if differences:
            go_on = self._kind.go_on.format(folder=self.path)
            raise ConfigError(
                f"{self.path} has another {self._kind.noun}: {'; '.join(differences)}. Choose "
                f"another folder, or put that right and go on: {go_on}"
            )
        return begun

    def done(self, orders: Iterable[RaceOrder]) -> dict[int, RaceResult]:
        """The results of the races that have been run, by number.

        Raises:
            ConfigError: a race's file is damaged or of another race.
        """
        return read_races(self.path, orders)

    def add(self, order: Order, result: str) -> None:
        """Keeps the result of a race."""
        write_whole(_race_file(self.path, order.number), result + "\n")


def read_races(folder: Path, orders: Iterable[RaceOrder]) -> dict[int, RaceResult]:
    """The races that have been run in a folder, by number.

    Raises:
        ConfigError: a race's file is damaged or of another race.
    """
    results = {}
    for order in orders:
        file = _race_file(folder, order.number)
        try:
            result = RaceResult.from_json(file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            continue
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"{file} cannot be read: {error}; delete it, and the race is run again"
            ) from error
        if not _is_of(result, order):
            raise ConfigError(
                f"{file} is of another race than was planned; delete it, and the race is run again"
            )
        results[order.number] = result
    return results


def _is_of(result: RaceResult, order: RaceOrder) -> bool:
    settings = order.settings
    grid = [row.driver for row in sorted(result.agents, key=lambda row: row.start_position)]
    found = result.seed, result.track, result.reverse, result.difficulty, grid
    wanted = settings.seed, settings.track, settings.reverse, settings.difficulty, order.labels
    return found == wanted


def write_whole(file: Path, text: str) -> None:
    """Writes a file so that it is there whole, also after a power cut, or not at all.

    Raises:
        ConfigError: it cannot be written.
    """
    try:
        with atomic_write(file) as part:
            part.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{file} cannot be written: {error}") from error


def _race_file(folder: Path, number: int) -> Path:
    return folder / _RACES / f"{number:05d}.json"


def _take(lock: IO[str]) -> bool:
    """Locks a file; the system frees it when this process ends, however it ends."""
    try:
        import fcntl
    except ImportError:  # Windows
        return True
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
