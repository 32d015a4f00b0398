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

from stkzoo._arguments import option
from stkzoo._checks import check_number, check_whole
from stkzoo._locks import locked_folder
from stkzoo._os import cpu_count, make_folder, write_text
from stkzoo.errors import StkzooError
from stkzoo.evaluation.batch.order import RACES, RaceOrder, load_orders
from stkzoo.evaluation.batch.plan import RESULT_FILE, BatchPlan
from stkzoo.evaluation.batch.pool import run_in_parallel
from stkzoo.evaluation.plotting import require_matplotlib
from stkzoo.race.document import Document
from stkzoo.race.result import RaceResult

_MAX_ERRORS_SHOWN = 3

Plan = TypeVar("Plan", bound=BatchPlan)
Result = TypeVar("Result")
Stored = TypeVar("Stored", bound=Document)
#: Results of the races of a batch that have been run, by number.
RaceResults = Mapping[int, RaceResult]


@dataclass(frozen=True, slots=True)
class BatchProgress:
    """The progress of a batch.

    Attributes:
        done: number of stored races.
        total: number of all races.
        last: result of the race that has just finished; ``None`` at the beginning, and for a race
            that could not be run.
        failed: number of races that could not be run.
    """

    done: int
    total: int
    last: RaceResult | None = None
    failed: int = 0


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options for running a batch. They do not affect its results.

    The attribute texts are also the help of the commands' options.

    Attributes:
        jobs: races at the same time (default: all CPU cores)
        race_timeout: time limit of one race [s]; a longer race is repeated with a time budget for
            each agent
        on_race: function called at the beginning and after every race.
        plot: whether to plot the result.
    """

    jobs: int | None = None
    race_timeout: float = option(3600.0, metavar="SECONDS")
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
        names = {entry.name for entry in fields(cls)} & set(options)
        others = {name: value for name, value in options.items() if name not in names}
        return cls(**{name: options[name] for name in names}), others


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


@dataclass(frozen=True, slots=True)
class BatchKind(Generic[Plan, Result]):
    """A kind of batch: its plans, and the functions that make a result from the races of one.

    Attributes:
        plan_type: class of its plans.
        summarize: returns the result of the races that have been run, by number. The last argument
            is the folder of the batch.
        write: writes a result, and what belongs to it except the plot, to the folder; its arguments
            are the result, the results of the races by number and the folder.
        plot: plots a result to a file; ``None`` for no plot.
        plot_name: name of the file of the plot.
        check: raises an error before the first race if another library is missing.
        is_partial: whether a part of the races has a result.
    """

    plan_type: type[Plan]
    summarize: Callable[[Plan, RaceResults, Path], Result]
    write: Callable[[Result, RaceResults, Path], object]
    plot: Callable[[Result, Path], object] | None = None
    plot_name: str = ""
    check: Callable[[], object] = lambda: None
    is_partial: bool = True

    def run(self, plan: Plan, folder: Path, options: RunOptions) -> Result:
        """Runs the races of a plan that are not stored yet, and returns the result of all races.

        Args:
            plan: plan of the batch.
            folder: folder of the batch, which is created if needed and locked meanwhile.
            options: options of the run.

        Raises:
            ConfigError: the folder cannot be used, contains another plan or a damaged race, or
                another program runs a batch in it; or a library is missing.
            BatchError: some races could not be run; the error has the result of the others.
        """
        self.check()
        plot = self.plot if options.plot else None
        if plot:
            require_matplotlib(alternative="or leave the plot out (--no-plot)")
        with locked_folder(folder, plan.noun):
            make_folder(folder / RACES, plan.noun)
            plan = plan.kept(folder)
            orders = plan.orders()
            results = load_orders(orders, folder)
            errors = run_orders(orders, folder, options, results)
            if errors and not self.is_partial:
                raise BatchError.of(errors, len(orders), None)
            result = self.summarize(plan, results, folder)
            self.write(result, results, folder)
            if plot and results:
                plot(result, folder / self.plot_name)
            if errors:
                raise BatchError.of(errors, len(orders), result)
            return result

    def load(self, path: str | os.PathLike[str], result_type: type[Stored]) -> Result | Stored:
        """Returns the current result without running any race.

        Args:
            path: folder of a batch, or the file of a result.
            result_type: class of the results.

        Raises:
            ConfigError: there is no result, the plan or a race is damaged, or the plan is of
                another kind.
        """
        place = Path(path)
        plan = self.plan_type.find(place)
        if plan is not None:
            return self.summarize(plan, load_orders(plan.orders(), place), place)
        return result_type.load(place / RESULT_FILE if place.is_dir() else place)


def written(name: str) -> Callable[[Document, RaceResults, Path], None]:
    """Returns the function that writes a result to a file of a name, for :class:`BatchKind`."""
    return lambda result, _, folder: write_text(folder / name, result.to_json() + "\n")


def run_orders(
    orders: Sequence[RaceOrder], folder: Path, options: RunOptions, results: dict[int, RaceResult]
) -> dict[int, str]:
    """Runs races in parallel, reports their progress, and stores and collects their results.

    Args:
        orders: all races of the batch.
        folder: folder of the batch.
        options: options of the run.
        results: results by number; races that have one do not run. The others are added.

    Returns:
        Why races could not be run, by number.
    """
    report = options.on_race or (lambda _: None)
    report(BatchProgress(len(results), len(orders)))
    left, errors = [order for order in orders if order.number not in results], {}
    running = run_in_parallel(left, folder, options.jobs or cpu_count(), options.race_timeout)
    with closing(running) as outcomes:  # after an error, close() ends the running races
        for order, (text, error) in outcomes:
            result = None if error else RaceResult.from_json(text)
            if result is None:
                errors[order.number] = error
            else:
                order.store(folder, result)
                results[order.number] = result
            report(BatchProgress(len(results), len(orders), result, len(errors)))
    return errors
