"""Runs a batch in its folder, and resumes it.

The folder has the plan and one file per race. Each file is flushed to the disk and moved into
place in one step, so a race is stored whole or not at all, however the program ends.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from stkzoo._os import PART_FILES, cpu_count, try_lock, write_text
from stkzoo.errors import ConfigError, StkzooError, check_whole
from stkzoo.evaluation.batch.order import BatchOrder, load_orders
from stkzoo.evaluation.batch.plan import PLAN_FILE, BatchPlan, read_plan
from stkzoo.evaluation.batch.pool import run_in_parallel
from stkzoo.evaluation.plotting import require_matplotlib
from stkzoo.race.result import RaceResult

#: The file of the result in a batch's folder.
RESULT_FILE = "result.json"
RACE_TIMEOUT = 3600.0  # [s]
_MAX_ERRORS_SHOWN = 3


class BatchSummary(Protocol):
    """The result of a batch."""

    def to_json(self) -> str:
        """The result as JSON."""


Plan = TypeVar("Plan", bound=BatchPlan)
Result = TypeVar("Result")
Summary = TypeVar("Summary")
Writable = TypeVar("Writable", bound=BatchSummary)


@dataclass(frozen=True, slots=True)
class BatchProgress:
    """How far a batch has come.

    Attributes:
        done: races that are stored.
        total: all races.
        last: the race that has just finished; ``None`` at the beginning, and for one that could
            not be run.
        error: why it could not be run.
    """

    done: int
    total: int
    last: RaceResult | None = None
    error: str = ""


ProgressListener = Callable[[BatchProgress], object]


@dataclass(frozen=True, slots=True)
class RunOptions:
    """How a batch is run; changes nothing in its results.

    Attributes:
        jobs: races at a time; ``None`` for as many as there are processors.
        race_timeout: for one race [s].
        on_race: is called after every race.
    """

    jobs: int | None = None
    race_timeout: float = RACE_TIMEOUT
    on_race: ProgressListener | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None:
            check_whole("jobs", self.jobs, 1)
        if not 0 < self.race_timeout < 1e9:
            raise ConfigError(f"race_timeout is {self.race_timeout!r}, expected seconds above 0")


class BatchError(StkzooError, Generic[Summary]):
    """Some races could not be run; the others are stored.

    Attributes:
        result: the result of the others; ``None`` where one needs all races.
    """

    def __init__(self, message: str, result: Summary | None = None) -> None:
        super().__init__(message)
        self.result = result

    @classmethod
    def of(cls, errors: Mapping[int, str], total: int, result: Summary) -> BatchError[Summary]:
        """The error for some of ``total`` races, with why each of them could not be run."""
        first = list(errors.items())[:_MAX_ERRORS_SHOWN]
        lines = "".join(f"\nrace {number}: {error}" for number, error in first)
        more = f"\n... and {len(errors) - len(first)} more" if len(errors) > len(first) else ""
        return cls(
            f"{len(errors)} of {total} races could not be run; the others are kept, and the same "
            f"command tries these again:{lines}{more}",
            result,
        )


@dataclass(slots=True)
class Batch(Generic[Plan]):
    """A batch in its folder.

    Attributes:
        folder: where it is stored.
        plan: the plan as it was started there.
        errors: why races could not be run, by number.
    """

    folder: Path
    plan: Plan
    errors: dict[int, str] = field(default_factory=dict)

    def run(self, orders: Sequence[BatchOrder[Result]], options: RunOptions) -> dict[int, Result]:
        """Runs the races that are not stored yet.

        Returns:
            The results of all races that have been run, by number.

        Raises:
            ConfigError: a stored race is damaged, or a race cannot be stored.
        """
        report = options.on_race or (lambda _: None)
        results = load_orders(orders, self.folder)
        report(BatchProgress(len(results), len(orders)))
        left = [order for order in orders if order.number not in results]
        running = run_in_parallel(left, options.jobs or cpu_count(), options.race_timeout)
        with closing(running) as outcomes:  # an error here ends the races that run
            for outcome in outcomes:
                number, last = outcome.order.number, None
                if outcome.error:
                    self.errors[number] = outcome.error
                else:
                    results[number] = outcome.order.store(self.folder, outcome.result)
                    last = RaceResult.from_json(outcome.result)
                report(BatchProgress(len(results), len(orders), last, outcome.error))
        return results

    def write(self, name: str, text: str) -> None:
        """Writes a text file into the folder, atomically.

        Raises:
            ConfigError: it cannot be written.
        """
        write_text(self.folder / name, text + "\n")


@contextmanager
def open_batch(plan: Plan, folder: str | os.PathLike[str]) -> Iterator[Batch[Plan]]:
    """Starts or resumes a batch; no other program can use its folder meanwhile.

    Args:
        plan: the batch.
        folder: its folder; it is created if needed.

    Raises:
        ConfigError: the folder cannot be used, another program runs this batch, or the folder has
            another batch.
    """
    path = Path(folder)
    with _locked(path, plan.noun):
        for place in (path, path / "races"):
            for part in place.glob(PART_FILES):  # left by a program that was killed while it wrote
                part.unlink(missing_ok=True)
        yield Batch(path, _keep_plan(plan, path))


def run_batch(
    plan: Plan,
    output: str | os.PathLike[str],
    options: RunOptions,
    summarize: Callable[[Plan, Mapping[int, RaceResult]], Writable],
    plot: Callable[[Writable, Path], None] | None = None,
) -> Writable:
    """Runs a batch of races, or resumes it, and writes its ``result.json`` and plot.

    Args:
        plan: the batch.
        output: its folder.
        options: how to run it.
        summarize: makes the result of the races that have been run.
        plot: draws the result into a file; ``None`` for no plot.

    Raises:
        ConfigError: see :func:`open_batch`; or matplotlib is missing.
        BatchError: some races could not be run; it has the result of the others.
    """
    if plot is not None:
        require_matplotlib(plan.noun, "leave the plot out (--no-plot)")
    with open_batch(plan, output) as batch:
        orders = batch.plan.orders()
        results = batch.run(orders, options)
        result = summarize(batch.plan, results)
        batch.write(RESULT_FILE, result.to_json())
        if plot is not None and results:
            plot(result, batch.folder / f"{plan.noun}.png")
    if batch.errors:
        raise BatchError.of(batch.errors, len(orders), result)
    return result


@contextmanager
def _locked(folder: Path, noun: str) -> Iterator[None]:
    try:
        (folder / "races").mkdir(parents=True, exist_ok=True)
        lock = (folder / "lock").open("a")
    except OSError as error:
        raise ConfigError(f"the {noun}'s folder {folder} cannot be used: {error}") from error
    with lock:
        if not try_lock(lock.fileno()):
            raise ConfigError(
                f"another program runs the {noun} in {folder}; wait until it ends, or choose "
                "another folder"
            )
        yield


def _keep_plan(plan: Plan, folder: Path) -> Plan:
    """Writes the plan, or returns the one in the folder if it leads to the same races."""
    if not (folder / PLAN_FILE).exists():
        Batch(folder, plan).write(PLAN_FILE, plan.to_json())
        return plan
    started = read_plan(type(plan), folder)
    if differences := started.differences(plan):
        raise ConfigError(
            f"{folder} has another {plan.noun}: {'; '.join(differences)}. Choose another folder, "
            f"or correct that and resume: {plan.resume_command.format(folder=folder)}"
        )
    return started
