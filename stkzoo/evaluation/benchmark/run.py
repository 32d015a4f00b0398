"""Runs a benchmark, or goes on with one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stkzoo.errors import ConfigError, StkzooError
from stkzoo.evaluation.batch import (
    RACE_TIMEOUT,
    BatchFolder,
    BatchRunner,
    ProgressListener,
    errors_in_words,
    read_races,
    write_whole,
)
from stkzoo.evaluation.benchmark.plan import BENCHMARK, BenchmarkPlan, plan_benchmark
from stkzoo.evaluation.benchmark.plot import plot_benchmark
from stkzoo.evaluation.benchmark.races import FORMS
from stkzoo.evaluation.benchmark.result import BenchmarkResult, benchmark_result
from stkzoo.evaluation.plotting import require_matplotlib

__all__ = ["BenchmarkError", "load_benchmark", "run_benchmark", "run_plan"]

_RESULT, _PLOT, _PLAN = "result.json", "benchmark.png", "plan.json"


class BenchmarkError(StkzooError):
    """Some races could not be run; the others have been, and are kept.

    Attributes:
        result: what the others came to.
    """

    def __init__(self, message: str, result: BenchmarkResult) -> None:
        super().__init__(message)
        self.result = result


def run_benchmark(
    agent: str,
    *,
    output: str | os.PathLike[str],
    split: str | Sequence[str] = "test",
    difficulty: int = 3,
    forms: Sequence[str] = FORMS,
    seeds: int = 5,
    reverse: Sequence[bool] = (False, True),
    ai_times: str | os.PathLike[str] | None = None,
    jobs: int | None = None,
    plot: bool = True,
    race_timeout: float = RACE_TIMEOUT,
    on_race: ProgressListener | None = None,
    **settings: Any,
) -> BenchmarkResult:
    """Measures an agent, or goes on with that if it has been begun in ``output``.

    Args:
        agent: see :func:`~stkzoo.evaluation.benchmark.plan_benchmark`, as for ``split``,
            ``difficulty``, ``forms``, ``seeds``, ``reverse``, ``ai_times`` and ``settings``.
        output: a folder of its own: every race's result as soon as it is over, and in the
            end ``result.json`` and ``benchmark.png``.
        split: the tracks.
        difficulty: level of the game's AI.
        forms: who drives.
        seeds: races of each kind.
        reverse: the directions.
        ai_times: file with the AI's times.
        jobs: how many races at a time; by default as many as there are processors. It
            changes nothing in the result.
        plot: draw ``benchmark.png``.
        race_timeout: for one race [s].
        on_race: is told of every race.
        settings: ``settings``, and fields of :class:`~stkzoo.race.RaceSettings`.

    Raises:
        ConfigError: an argument cannot be, a library is missing, or ``output`` has another
            benchmark.
        AssetError: the game's data is missing.
        BenchmarkError: some races could not be run.
    """
    plan = plan_benchmark(
        agent,
        split=split,
        difficulty=difficulty,
        forms=forms,
        seeds=seeds,
        reverse=reverse,
        ai_times=ai_times,
        **settings,
    )
    return run_plan(plan, output, BatchRunner(jobs, race_timeout, on_race), plot=plot)


def run_plan(
    plan: BenchmarkPlan,
    output: str | os.PathLike[str],
    runner: BatchRunner,
    *,
    plot: bool = True,
) -> BenchmarkResult:
    """Runs a planned benchmark, or goes on with it.

    Args:
        plan: the benchmark.
        output: its folder.
        runner: runs the races.
        plot: draw ``benchmark.png``.

    Raises: as :func:`run_benchmark`.
    """
    if plot:
        require_matplotlib("benchmark", "leave the plot out (--no-plot)")
    with BatchFolder(BENCHMARK, output) as folder:
        plan = folder.keep_plan(plan)
        orders = plan.orders()
        results, errors = runner.run(folder, orders)
        result = benchmark_result(plan, results)
        write_whole(folder.path / _RESULT, result.to_json() + "\n")
        if plot and results:
            plot_benchmark(result, folder.path / _PLOT)
    if errors:
        raise BenchmarkError(errors_in_words(errors, len(orders)), result)
    return result


def load_benchmark(path: str | os.PathLike[str]) -> BenchmarkResult:
    """What a benchmark has come to so far; runs nothing.

    Args:
        path: its folder, or a ``result.json``.

    Raises:
        ConfigError: there is none, or it is damaged.
    """
    place = Path(path)
    if (place / _PLAN).exists():
        plan = BENCHMARK.read_plan(place)
        return benchmark_result(plan, read_races(place, plan.orders()))
    file = place / _RESULT if place.is_dir() else place
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{path} has no benchmark ({error}); expected the --output of one, or its {_RESULT}"
        ) from error
    return BenchmarkResult.from_json(text)
