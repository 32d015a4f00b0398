"""The folder of a tournament: its plan, and one file for each race that has been run.

A race's file is written beside, flushed to the disk and put in its place in one step. So
whatever ends the program, a race is there whole or not at all.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import IO

from stkzoo.errors import ConfigError
from stkzoo.race.result import RaceResult
from stkzoo.race.tournament.plan import TournamentPlan
from stkzoo.race.tournament.schedule import ScheduledRace

__all__ = ["Journal", "write_whole"]

_PLAN, _RACES, _LOCK = "plan.json", "races", "lock"
_PART = ".*.part"


class Journal:
    """The folder of one tournament. A context manager: nobody else has it meanwhile.

    Args:
        folder: where; it is made if there is none.

    Raises:
        ConfigError: it cannot be made, or another program runs this tournament.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)
        try:
            (self.folder / _RACES).mkdir(parents=True, exist_ok=True)
            self._lock = (self.folder / _LOCK).open("a")
        except OSError as error:
            raise ConfigError(
                f"the tournament's folder {self.folder} cannot be used: {error}"
            ) from error
        if not _take(self._lock):
            self._lock.close()
            raise ConfigError(
                f"another program runs the tournament in {self.folder}; wait for its end, or "
                "choose another folder"
            )
        for place in (self.folder, self.folder / _RACES):
            for part in place.glob(_PART):  # of a program that was killed while it wrote
                part.unlink(missing_ok=True)

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *exception: object) -> None:
        self._lock.close()

    def keep_plan(self, plan: TournamentPlan) -> TournamentPlan:
        """Writes the plan, or checks that it is the one that was begun here.

        Returns:
            The plan as it was begun.

        Raises:
            ConfigError: another tournament was begun in this folder.
        """
        file = self.folder / _PLAN
        if not file.exists():
            write_whole(file, plan.to_json() + "\n")
            return plan
        begun = read_plan(self.folder)
        differences = begun.differences(plan)
        if differences:
            raise ConfigError(
                f"{self.folder} has another tournament: {'; '.join(differences)}. Choose another "
                f"folder, or put that right and go on: stkzoo tournament --resume {self.folder}"
            )
        return begun

    def done(self, plan: TournamentPlan) -> dict[int, RaceResult]:
        """The results of the races that have been run, by number."""
        return read_races(self.folder, plan)

    def add(self, race: ScheduledRace, result: str) -> None:
        """Keeps the result of a race."""
        write_whole(_race_file(self.folder, race.number), result + "\n")


def read_plan(folder: Path) -> TournamentPlan:
    """The plan of the tournament in a folder.

    Raises:
        ConfigError: there is none, or it cannot be read.
    """
    try:
        return TournamentPlan.from_json((folder / _PLAN).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{folder} has no tournament ({error}); expected the --output of one"
        ) from error


def read_races(folder: Path, plan: TournamentPlan) -> dict[int, RaceResult]:
    """The races that have been run in a folder, by number.

    Raises:
        ConfigError: a race's file is damaged or of another race.
    """
    results = {}
    for race in plan.schedule():
        file = _race_file(folder, race.number)
        try:
            result = RaceResult.from_json(file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            continue
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"{file} cannot be read: {error}; delete it, and the race is run again"
            ) from error
        grid = [row.driver for row in sorted(result.agents, key=lambda row: row.start_position)]
        expected = [plan.entrants[number].label for number in race.grid]
        if (result.seed, result.track, grid) != (race.seed, race.track, expected):
            raise ConfigError(
                f"{file} is of another race than this tournament's; delete it, and the race is "
                "run again"
            )
        results[race.number] = result
    return results


def write_whole(file: Path, text: str) -> None:
    """Writes a file so that it is there whole, also after a power cut, or not at all.

    Raises:
        ConfigError: it cannot be written.
    """
    beside = file.with_name(_PART.replace("*", f"{file.name}.{os.getpid()}"))
    try:
        with beside.open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        beside.replace(file)
        _flush_folder(file.parent)
    except OSError as error:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise ConfigError(f"{file} cannot be written: {error}") from error


def _race_file(folder: Path, number: int) -> Path:
    return folder / _RACES / f"{number:05d}.json"


def _flush_folder(folder: Path) -> None:
    with contextlib.suppress(OSError, AttributeError):  # not everywhere can folders be flushed
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


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
