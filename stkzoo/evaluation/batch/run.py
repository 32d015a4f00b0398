"""Runs a batch in its folder, and resumes it.

The folder has the plan and one file per race. Each file is flushed to the disk and moved into
place in one step, so a race is stored whole or not at all, however the program ends.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Generic, TypeVar

from stkzoo._os import PART_FILES, cpu_count, try_lock, write_text
from stkzoo.errors import ConfigError, StkzooError, check_number, check_whole, reason
from stkzoo.evaluation.batch.order import RACES, RaceOrder, load_orders
from stkzoo.evaluation.batch.plan import PLAN_FILE, RESULT_FILE, BatchPlan, Plan, Result
from stkzoo.evaluation.batch.pool import run_in_parallel
from stkzoo.race.document import Document
from stkzoo.race.result import RaceResult

_MAX_ERRORS_SHOWN = 3

AnyDocument = TypeVar("AnyDocument", bound=Document)


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


@dataclass(frozen=True, slots=True)
class RunOptions:
    """How a batch is run; changes nothing in its results.

    Attributes:
        jobs: races at a time; ``None`` for as many as there are processors.
        race_timeout: for one race [s].
        on_race: is called after every race.
        plot: draw the result.
    """

    jobs: int | None = None
    race_timeout: float = 3600.0
    on_race: Callable[[BatchProgress], object] | None = None
    plot: bool = True

    def __post_init__(self) -> None:
        if self.jobs is not None:
            check_whole("jobs", self.jobs, 1)
        check_number("race_timeout", self.race_timeout, unit="seconds")

    @classmethod
    def split(cls, options: Mapping[str, Any]) -> tuple[RunOptions, dict[str, Any]]:
        """The options of a run that some keyword arguments have, and the other arguments."""
        own = {entry.name for entry in fields(cls)} & set(options)
        others = {name: value for name, value in options.items() if name not in own}
        return cls(**{name: options[name] for name in own}), others


class BatchError(StkzooError, Generic[Result]):
    """Some races could not be run; the others are stored.

    Attributes:
        result: the result of the others; ``None`` where one needs all races.
    """

    def __init__(self, message: str, result: Result | None = None) -> None:
        super().__init__(message)
        self.result = result

    @classmethod
    def of(cls, errors: Mapping[int, str], total: int, result: Result | None) -> BatchError[Result]:
        """The error for some of ``total`` races, with why each of them could not be run."""
        first = list(errors.items())[:_MAX_ERRORS_SHOWN]
        lines = "".join(f"\nrace {number}: {error}" for number, error in first)
        more = f"\n... and {len(errors) - len(first)} more" if len(errors) > len(first) else ""
        return cls(
            f"{len(errors)} of {total} races could not be run; the others are kept, and the same "
            f"command tries these again:{lines}{more}",
            result,
        )


def run_batch(
    plan: BatchPlan[Result], output: str | os.PathLike[str], options: RunOptions
) -> Result:
    """Runs the races of a batch that are not stored yet, and writes the result and its plot.

    Args:
        plan: the batch.
        output: its folder; it is created if needed. No other program can use it meanwhile.
        options: how to run it.

    Raises:
        ConfigError: the folder cannot be used, another program runs this batch, the folder has
            another batch or a damaged race, or a library is missing.
        BatchError: some races could not be run; it has the result of the others.
    """
    folder = Path(output)
    plan.require_libraries(options.plot)
    result = None
    with _locked(folder, plan.noun):
        plan = _keep_plan(plan, folder)
        orders = plan.orders()
        results, errors = _run_orders(orders, folder, options)
        if plan.is_gradual or not errors:
            result = plan.summarize(results, folder)
            if isinstance(result, Document):
                write_text(folder / plan.result_file, result.to_json() + "\n")
            if plan.is_gradual and options.plot and results:
                plan.draw(result, folder / f"{plan.noun}.png")
            if results:
                plan.report(result, results, folder)
    if errors or result is None:
        raise BatchError.of(errors, len(orders), result)
    return result


def load_batch(
    plan_type: type[BatchPlan[AnyDocument]],
    result_type: type[AnyDocument],
    path: str | os.PathLike[str],
) -> AnyDocument:
    """The result of a batch so far, without running anything.

    Args:
        plan_type: of its plan.
        result_type: of its result.
        path: its folder, or the file of its result.

    Raises:
        ConfigError: there is none, it is damaged, or a library is missing.
    """
    place = Path(path)
    if (place / PLAN_FILE).exists():
        plan = plan_type.load(place / PLAN_FILE)
        return plan.summarize(load_orders(plan.orders(), place), place)
    return result_type.load(place / RESULT_FILE if place.is_dir() else place)


def _run_orders(
    orders: Sequence[RaceOrder], folder: Path, options: RunOptions
) -> tuple[dict[int, RaceResult], dict[int, str]]:
    """The results of all races that have been run, by number, and why others could not be run."""
    report = options.on_race or (lambda _: None)
    results, errors = load_orders(orders, folder), {}
    report(BatchProgress(len(results), len(orders)))
    left = [order for order in orders if order.number not in results]
    running = run_in_parallel(left, folder, options.jobs or cpu_count(), options.race_timeout)
    with closing(running) as outcomes:  # an error here ends the races that run
        for outcome in outcomes:
            number, last = outcome.order.number, None
            if outcome.error:
                errors[number] = outcome.error
            else:
                last = results[number] = outcome.order.store(folder, outcome.result)
            report(BatchProgress(len(results), len(orders), last, outcome.error))
    return results, errors


@contextmanager
def _locked(folder: Path, noun: str) -> Iterator[None]:
    try:
        (folder / RACES).mkdir(parents=True, exist_ok=True)
        lock = (folder / "lock").open("a")
    except OSError as error:
        raise ConfigError(
            f"the {noun}'s folder {folder} cannot be used: {reason(error)}; choose another --output"
        ) from error
    with lock:
        if not try_lock(lock.fileno()):
            raise ConfigError(
                f"another program runs the {noun} in {folder}; wait until it ends, or choose "
                "another folder"
            )
        for place in (folder, folder / RACES):
            for part in place.glob(PART_FILES):  # left by a program that was killed while it wrote
                part.unlink(missing_ok=True)
        yield


def _keep_plan(plan: Plan, folder: Path) -> Plan:
    """Writes the plan, or returns the one in the folder if it leads to the same races."""
    file = folder / PLAN_FILE
    started = type(plan).load(file) if file.exists() else None
    kept = started.continued(plan).shown_like(plan) if started else plan
    if differences := kept.differences(plan):
        raise ConfigError(
            f"{folder} has another {plan.noun}: {'; '.join(differences)}. Choose another folder, "
            f"or correct that and resume: {plan.resume_command.format(folder=folder)}"
        )
    if kept != started:
        write_text(file, kept.to_json() + "\n")
    return kept
