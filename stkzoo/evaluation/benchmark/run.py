"""Runs and resumes benchmarks, and reads them from their folders."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stkzoo.evaluation.batch.order import load_orders
from stkzoo.evaluation.batch.plan import RESULT_FILE, find_plan, result_file
from stkzoo.evaluation.batch.run import RunOptions, run_plotted_batch
from stkzoo.evaluation.benchmark.plan import (
    BenchmarkPlan,
    BenchmarkResult,
    benchmark_orders,
    plan_benchmark,
)
from stkzoo.evaluation.benchmark.plot import plot_benchmark
from stkzoo.evaluation.benchmark.races import RaceOutcome
from stkzoo.race.result import RaceResult, shared_protections


def run_benchmark(agent: str, *, output: str | os.PathLike[str], **options: Any) -> BenchmarkResult:
    """Runs a benchmark of an agent, or resumes it if it was started in ``output``.

    Args:
        agent: the agent to measure; see :func:`~stkzoo.evaluation.plan_benchmark`.
        output: folder for the result of each race, ``result.json`` and ``benchmark.png``.
        options: ``jobs``, ``race_timeout``, ``on_race`` and ``plot``, as in
            :class:`~stkzoo.evaluation.RunOptions`; all others as for
            :func:`~stkzoo.evaluation.plan_benchmark`.

    Raises:
        ConfigError: an argument is invalid, a library is missing, or ``output`` contains another
            benchmark.
        AssetError: the game's data is missing.
        BatchError: some races could not be run.
    """
    run, plan = RunOptions.split(options)
    return run_planned_benchmark(plan_benchmark(agent, **plan), Path(output), run)


def run_planned_benchmark(
    plan: BenchmarkPlan, folder: Path, options: RunOptions
) -> BenchmarkResult:
    """Runs or resumes a planned benchmark; see :func:`run_benchmark`."""
    return run_plotted_batch(
        plan,
        folder,
        options,
        orders=benchmark_orders,
        summarize=_result,
        plot=plot_benchmark,
        files=(RESULT_FILE, "benchmark.png"),
    )


def _result(plan: BenchmarkPlan, results: Mapping[int, RaceResult]) -> BenchmarkResult:
    protections = shared_protections(results.values())
    return BenchmarkResult(plan, race_outcomes(plan, results), *protections)


def race_outcomes(
    plan: BenchmarkPlan, results: Mapping[int, RaceResult]
) -> tuple[RaceOutcome, ...]:
    """Returns the outcomes of the races that have been run.

    Args:
        plan: the benchmark.
        results: results of races by number.
    """
    return tuple(
        RaceOutcome.of(
            race, results[race.number], plan.ai_time(race.track, race.reverse), plan.limit
        )
        for race in plan.races()
        if race.number in results
    )


def load_benchmark(path: str | os.PathLike[str]) -> BenchmarkResult:
    """Returns the current result of a benchmark without running any race.

    Args:
        path: folder of the benchmark, or a ``result.json``.

    Raises:
        ConfigError: there is no result, or a file is damaged.
    """
    if plan := find_plan(BenchmarkPlan, path):
        return _result(plan, load_orders(benchmark_orders(plan), Path(path)))
    return BenchmarkResult.load(result_file(path))
