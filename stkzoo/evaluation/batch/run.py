"""Runs and resumes a batch in its folder.

The folder contains the plan and one file per race. Each file is flushed to the disk and moved into
place atomically, so a race is stored completely or not at all, even if the program crashes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Generic, TypeVar

from stkzoo._locks import locked_folder
from stkzoo._os import cpu_count, make_folder, write_text
from stkzoo.errors import StkzooError, check_number, check_whole
from stkzoo.evaluation.batch.order import RACES, RaceOrder, load_orders
from stkzoo.evaluation.batch.plan import Plan, keep_plan
from stkzoo.evaluation.batch.pool import run_in_parallel
from stkzoo.evaluation.plotting import require_plot
from stkzoo.race.document import Document
from stkzoo.race.result import RaceResult

_MAX_ERRORS_SHOWN = 3

Result = TypeVar("Result")
ResultDocument = TypeVar("ResultDocument", bound=Document)


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


@contextmanager
def open_batch(folder: Path, noun: str) -> Iterator[None]:
    """Creates the folder of a batch if needed, and locks it while the block runs.

    Args:
        folder: the folder.
        noun: name of this kind of batch.

    Raises:
        ConfigError: the folder cannot be used, or another program runs a batch in it.
    """
    with locked_folder(folder, noun):
        make_folder(folder / RACES, noun)
        yield


def run_batch(
    orders: Sequence[RaceOrder],
    folder: Path,
    summarize: Callable[[Mapping[int, RaceResult]], Result],
    options: RunOptions,
    *,
    is_partial: bool = True,
) -> Result:
    """Runs the races of a batch that are not stored yet, and returns the result of all races.

    Args:
        orders: all races of the batch.
        folder: folder of the batch, which is open (:func:`open_batch`).
        summarize: function that makes the result of the races that have been run, by number. It
            may also write the result and plots.
        options: options of the run.
        is_partial: whether a part of the races has a result.

    Raises:
        ConfigError: the folder contains a damaged race.
        BatchError: some races could not be run; the error has the result of the others.
    """
    results, errors = _run_orders(orders, folder, options)
    result = summarize(results) if is_partial or not errors else None
    if errors or result is None:
        raise BatchError.of(errors, len(orders), result)
    return result


def run_plotted_batch(
    plan: Plan,
    folder: Path,
    options: RunOptions,
    *,
    orders: Callable[[Plan], Sequence[RaceOrder]],
    summarize: Callable[[Plan, Mapping[int, RaceResult]], ResultDocument],
    plot: Callable[[ResultDocument, Path], object],
    files: tuple[str, str],
) -> ResultDocument:
    """Runs or resumes a planned batch, and writes its result and a plot of it.

    Args:
        plan: plan of the batch.
        folder: folder of the batch.
        options: options of the run.
        orders: function that makes the races of a plan.
        summarize: function that makes the result of the races that have been run, by number.
        plot: function that plots a result to a file.
        files: names of the files of the result and of the plot.

    Raises: as :func:`run_batch`; also ConfigError if the folder contains another plan or a library
        for the plot is missing.
    """
    require_plot(options.plot)
    result_name, plot_name = files
    with open_batch(folder, plan.noun):
        kept = keep_plan(plan, folder)

        def write(results: Mapping[int, RaceResult]) -> ResultDocument:
            result = summarize(kept, results)
            write_text(folder / result_name, result.to_json() + "\n")
            if options.plot and results:
                plot(result, folder / plot_name)
            return result

        return run_batch(orders(kept), folder, write, options)


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
