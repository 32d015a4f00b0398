"""How good an agent is: the same races for everybody, figures with intervals.

>>> from stkzoo.evaluation.benchmark import run_benchmark
>>> result = run_benchmark(
...     "heuristic", split=["lighthouse"], forms=["PAAAA"], seeds=2, output="/tmp/heuristic"
... )  # doctest: +SKIP
>>> result.group("track", "lighthouse").figures["time_ratio"].value  # doctest: +SKIP
0.97
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stkzoo.evaluation.benchmark.ai_times import AiTime, AiTimes, load_ai_times
    from stkzoo.evaluation.benchmark.baseline import measure_ai_times
    from stkzoo.evaluation.benchmark.comparison import Comparison, Difference, compare
    from stkzoo.evaluation.benchmark.outcome import KartOutcome, RaceOutcome
    from stkzoo.evaluation.benchmark.plan import BenchmarkPlan, plan_benchmark
    from stkzoo.evaluation.benchmark.plot import plot_benchmark
    from stkzoo.evaluation.benchmark.races import (
        FORMS,
        BenchmarkRace,
        RaceForm,
        make_races,
        race_seed,
    )
    from stkzoo.evaluation.benchmark.result import BenchmarkResult, Group, benchmark_result
    from stkzoo.evaluation.benchmark.run import BenchmarkError, load_benchmark, run_benchmark

__all__ = [
    "FORMS",
    "AiTime",
    "AiTimes",
    "BenchmarkError",
    "BenchmarkPlan",
    "BenchmarkRace",
    "BenchmarkResult",
    "Comparison",
    "Difference",
    "Group",
    "KartOutcome",
    "RaceForm",
    "RaceOutcome",
    "benchmark_result",
    "compare",
    "load_ai_times",
    "load_benchmark",
    "make_races",
    "measure_ai_times",
    "plan_benchmark",
    "plot_benchmark",
    "race_seed",
    "run_benchmark",
]

#: Names by module, loaded when they are first used: the command line needs few.
_LAZY = {
    "ai_times": (
        "AiTime",
        "AiTimes",
        "load_ai_times",
    ),
    "baseline": ("measure_ai_times",),
    "comparison": (
        "Comparison",
        "Difference",
        "compare",
    ),
    "outcome": (
        "KartOutcome",
        "RaceOutcome",
    ),
    "plan": (
        "BenchmarkPlan",
        "plan_benchmark",
    ),
    "plot": ("plot_benchmark",),
    "races": (
        "FORMS",
        "BenchmarkRace",
        "RaceForm",
        "make_races",
        "race_seed",
    ),
    "result": (
        "BenchmarkResult",
        "Group",
        "benchmark_result",
    ),
    "run": (
        "BenchmarkError",
        "load_benchmark",
        "run_benchmark",
    ),
}
_HOMES = {name: module for module, names in _LAZY.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
