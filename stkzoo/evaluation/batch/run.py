"""Runs and resumes a batch in its folder.

The folder contains the plan and one file per race. Each file is flushed to the disk and moved into
place atomically, so a race is stored completely or not at all, even if the program crashes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Generic, TypeVar

from stkzoo._locks import locked_folder
from stkzoo._os import cpu_count, make_folder, write_text
from stkzoo.errors import ConfigError, StkzooError, check_number, check_whole
from stkzoo.evaluation.batch.order import RACES, RaceOrder, load_orders
from stkzoo.evaluation.batch.plan import PLAN_FILE, RESULT_FILE, BatchPlan, Plan, Result
from stkzoo.evaluation.batch.pool import run_in_parallel
from stkzoo.race.document import Document
from stkzoo.race.result import RaceResult

_MAX_ERRORS_SHOWN = 3

AnyDocument = TypeVar("AnyDocument", bound=Document)


@dataclass(frozen=True, slots=True)
class BatchProgress:
    """The progress of a batch.

    Attributes:
        done: number of stored races.
        total: number of all races.
        last: result of the race that has just finished; ``None`` at the beginning, and for a race
            that could not be run.
        error: why the race could not be run; empty otherwise.
    """

    done: int
    total: int
    last: RaceResult | None = None
    error: str = ""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options for running a batch. They do not affect its results.

    Attributes:
        jobs: maximum number of races at the same time; ``None`` for the number of CPU cores.
        race_timeout: time limit of a race [s]. A longer race is repeated with a time budget for
            each agent.
        on_race: function called at the beginning and after every race.
        plot: whether to plot the result.
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
        """Splits keyword arguments into run options and other arguments.

        Args:
            options: the keyword arguments.
        """
        own = {entry.name for entry in fields(cls)} & set(options)
        others = {name: value for name, value in options.items() if name not in own}
        return cls(**{name: options[name] for name in own}), others


class BatchError(StkzooError, Generic[Result]):
    """Some races of a batch could not be run. The other races are stored.

    Attributes:
        result: result of the other races; ``None`` if a result requires all races.
    """

    def __init__(self, message: str, result: Result | None = None) -> None:
        super().__init__(message)
        self.result = result

    @classmethod
    def of(cls, errors: Mapping[int, str], total: int, result: Result | None) -> BatchError[Result]:
        """Returns the error for a batch.

        Args:
            errors: why races could not be run, by number.
            total: number of all races.
            result: result of the other races.
        """
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
        plan: plan of the batch.
        output: folder of the batch, which is created if needed. It is locked during the run.
        options: options of the run.

    Raises:
        ConfigError: the folder cannot be used, another program runs a batch in it, it contains
            another batch or a damaged race, or a library is missing.
        BatchError: some races could not be run; the error has the result of the others.
    """
    folder = Path(output)
    plan.require_libraries(options.plot)
    result = None
    with locked_folder(folder, plan.noun):
        make_folder(folder / RACES, plan.noun)
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
    """Returns the current result of a batch without running any race.

    Args:
        plan_type: type of the plan.
        result_type: type of the result.
        path: folder of the batch, or its result file.

    Raises:
        ConfigError: there is no result, a file is damaged, or a library is missing.
    """
    place = Path(path)
    if (place / PLAN_FILE).exists():
        plan = plan_type.load(place / PLAN_FILE)
        return plan.summarize(load_orders(plan.orders(), place), place)
    return result_type.load(place / RESULT_FILE if place.is_dir() else place)


def _run_orders(
    orders: Sequence[RaceOrder], folder: Path, options: RunOptions
) -> tuple[dict[int, RaceResult], dict[int, str]]:
    """Runs the races that are not stored yet.

    Returns:
        The results of all races that have been run, and why others could not be run, by number.
    """
    report = options.on_race or (lambda _: None)
    results, errors = load_orders(orders, folder), {}
    report(BatchProgress(len(results), len(orders)))
    left = [order for order in orders if order.number not in results]
    running = run_in_parallel(left, folder, options.jobs or cpu_count(), options.race_timeout)
    with closing(running) as outcomes:  # after an error, close() ends the running races
        for outcome in outcomes:
            number, last = outcome.order.number, None
            if outcome.error:
                errors[number] = outcome.error
            else:
                last = results[number] = outcome.order.store(folder, outcome.result)
            report(BatchProgress(len(results), len(orders), last, outcome.error))
    return results, errors


def _keep_plan(plan: Plan, folder: Path) -> Plan:
    """Returns the plan to run, and stores it in the folder if it is not stored yet.

    Args:
        plan: the requested plan.
        folder: folder of the batch.

    Raises:
        ConfigError: the folder contains a plan for other races.
    """
    file = folder / PLAN_FILE
    started = type(plan).load(file) if file.exists() else None
    kept = started.moved(folder).continued(plan).shown_like(plan) if started else plan
    if differences := kept.differences(plan):
        raise ConfigError(
            f"{folder} has another {plan.noun}: {'; '.join(differences)}. Choose another output, "
            f"or undo the change and resume: {plan.resume_command.format(folder=folder)}"
        )
    if kept != started:
        write_text(file, kept.to_json() + "\n")
    return kept
