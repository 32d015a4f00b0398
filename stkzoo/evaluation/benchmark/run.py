"""Runs a benchmark, or resumes one."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.order import load_orders
from stkzoo.evaluation.batch.plan import PLAN_FILE, read_plan
from stkzoo.evaluation.batch.run import (
    RACE_TIMEOUT,
    RESULT_FILE,
    ProgressListener,
    RunOptions,
    run_batch,
)
from stkzoo.evaluation.benchmark.plan import BenchmarkPlan, plan_benchmark
from stkzoo.evaluation.benchmark.plot import plot_benchmark
from stkzoo.evaluation.benchmark.result import BenchmarkResult, benchmark_result


def run_benchmark(
    agent: str,
    *,
    output: str | os.PathLike[str],
    jobs: int | None = None,
    plot: bool = True,
    race_timeout: float = RACE_TIMEOUT,
    on_race: ProgressListener | None = None,
    **plan: Any,
) -> BenchmarkResult:
    """Measures an agent, or resumes that if it was started in ``output``.

    Args:
        agent: the agent to measure; see :func:`~stkzoo.evaluation.plan_benchmark`.
        output: a folder of its own, for every race's result and finally ``result.json`` and
            ``benchmark.png``.
        jobs: see :class:`~stkzoo.evaluation.RunOptions`.
        plot: draw ``benchmark.png``.
        race_timeout: see :class:`~stkzoo.evaluation.RunOptions`.
        on_race: likewise.
        plan: ``split``, ``difficulty``, ``forms``, ``seeds``, ``reverse``, ``ai_times``,
            ``settings`` and fields of :class:`~stkzoo.race.RaceSettings`, as for
            :func:`~stkzoo.evaluation.plan_benchmark`.

    Raises:
        ConfigError: an argument is invalid, a library is missing, or ``output`` has another
            benchmark.
        AssetError: the game's data is missing.
        BatchError: some races could not be run.
    """
    options = RunOptions(jobs, race_timeout, on_race)
    return run_benchmark_plan(plan_benchmark(agent, **plan), output, options, plot=plot)


def run_benchmark_plan(
    plan: BenchmarkPlan, output: str | os.PathLike[str], options: RunOptions, *, plot: bool = True
) -> BenchmarkResult:
    """Runs a planned benchmark, or resumes it; see :func:`run_benchmark`."""
    return run_batch(plan, output, options, benchmark_result, plot_benchmark if plot else None)


def load_benchmark(path: str | os.PathLike[str]) -> BenchmarkResult:
    """The result of a benchmark so far, without running anything.

    Args:
        path: its folder, or a ``result.json``.

    Raises:
        ConfigError: there is none, or it is damaged.
    """
    place = Path(path)
    if (place / PLAN_FILE).exists():
        plan = read_plan(BenchmarkPlan, place)
        return benchmark_result(plan, load_orders(plan.orders(), place))
    file = place / RESULT_FILE if place.is_dir() else place
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{path} has no benchmark ({error}); expected the --output of one, or its {RESULT_FILE}"
        ) from error
    return BenchmarkResult.from_json(text)
