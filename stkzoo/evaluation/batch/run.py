"""Runs the races of a batch that have not been run yet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from stkzoo._os import cpu_count
from stkzoo.errors import ConfigError, check_whole
from stkzoo.evaluation.batch.folder import BatchFolder
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.evaluation.batch.pool import run_in_parallel
from stkzoo.race.result import RaceResult

__all__ = ["RACE_TIMEOUT", "BatchProgress", "BatchRunner", "ProgressListener", "errors_in_words"]

RACE_TIMEOUT = 3600.0  # [s]
_MAX_TOLD = 3


@dataclass(frozen=True, slots=True)
class BatchProgress:
    """How far a batch has come.

    Attributes:
        done: races that have been run.
        total: races in all.
        last: the race that has just been run; ``None`` at the beginning, and for one that
            could not be run.
        error: why it could not be run.
    """

    done: int
    total: int
    last: RaceResult | None = None
    error: str = ""


ProgressListener = Callable[[BatchProgress], None]


class BatchRunner:
    """Runs orders in parallel.

    Args:
        jobs: how many races at a time; ``None`` for as many as there are processors.
        race_timeout: for one race [s].
        on_race: is told of every race.

    Raises:
        ConfigError: an argument cannot be.
    """

    def __init__(
        self,
        jobs: int | None = None,
        race_timeout: float = RACE_TIMEOUT,
        on_race: ProgressListener | None = None,
    ) -> None:
        if jobs is not None:
            check_whole("jobs", jobs, 1)
        if not 0 < race_timeout < 1e9:
            raise ConfigError(f"race_timeout is {race_timeout!r}, expected seconds above 0")
        self._jobs = jobs or cpu_count()
        self._race_timeout, self._on_race = race_timeout, on_race

    def run(
        self, folder: BatchFolder[Any], orders: Sequence[RaceOrder]
    ) -> tuple[dict[int, RaceResult], dict[int, str]]:
        """Runs what is not in the folder yet, and keeps it there.

        Returns:
            The results of all races that have been run, and why the others could not be, by
            number.
        """
        results = folder.done(orders)
        left = [order for order in orders if order.number not in results]
        errors: dict[int, str] = {}
        self._tell(BatchProgress(len(results), len(orders)))
        running = run_in_parallel(left, self._jobs, self._race_timeout)
        with closing(running) as outcomes:  # which ends the races that run, also after an error
            for outcome in outcomes:
                number, last = outcome.order.number, None
                if outcome.error:
                    errors[number] = outcome.error
                else:
                    folder.add(outcome.order, outcome.result)
                    last = results[number] = RaceResult.from_json(outcome.result)
                self._tell(BatchProgress(len(results), len(orders), last, outcome.error))
        return results, errors

    def _tell(self, progress: BatchProgress) -> None:
        if self._on_race is not None:
            self._on_race(progress)


def errors_in_words(errors: Mapping[int, str], total: int) -> str:
    """Which races could not be run, and why."""
    first = list(errors.items())[:_MAX_TOLD]
    lines = "".join(f"\nrace {number}: {error}" for number, error in first)
    more = f"\n... and {len(errors) - len(first)} more" if len(errors) > len(first) else ""
    return (
        f"{len(errors)} of {total} races could not be run; the others are kept, and the same "
        f"command tries these again:{lines}{more}"
    )
