"""Evaluation over many races: benchmarks, tournaments, ratings and demonstrations.

>>> from stkzoo.evaluation import run_benchmark, run_tournament
>>> result = run_benchmark(
...     "heuristic", split=["lighthouse"], forms=["PAAAA"], seeds=2, output="/tmp/heuristic"
... )  # doctest: +SKIP
>>> result.group("track", "lighthouse").figures["time_ratio"].value  # doctest: +SKIP
0.97
>>> result = run_tournament(
...     ["heuristic", "ai", "random"], tracks=["lighthouse"], races=3, output="/tmp/cup"
... )  # doctest: +SKIP
>>> result.standings[0].label  # doctest: +SKIP
'heuristic'

All of these run as batches: races run in parallel processes. Each result is stored in the output
folder as soon as its race ends, so the same call resumes after an interruption.
"""

from stkzoo.evaluation.agent_check import AgentReport, check_agent
from stkzoo.evaluation.batch.agents import BatchAgent
from stkzoo.evaluation.batch.run import BatchError, BatchProgress, RunOptions
from stkzoo.evaluation.benchmark.ai_times import AiTime, AiTimes, load_ai_times
from stkzoo.evaluation.benchmark.plan import BenchmarkPlan, plan_benchmark, plan_time_trial
from stkzoo.evaluation.benchmark.races import (
    FORMS,
    BenchmarkForm,
    BenchmarkRace,
    KartOutcome,
    RaceGroup,
    RaceOutcome,
)
from stkzoo.evaluation.benchmark.result import (
    BenchmarkResult,
    Comparison,
    compare,
    load_benchmark,
    plot_benchmark,
    run_benchmark,
    run_time_trial,
)
from stkzoo.evaluation.demonstrations.dataset import (
    DemoEpisode,
    Demonstrations,
    EpisodeFacts,
    load_demonstrations,
    save_demonstrations,
)
from stkzoo.evaluation.demonstrations.plan import (
    DemoPlan,
    plan_demonstrations,
    record_demonstrations,
)
from stkzoo.evaluation.demonstrations.recorder import DemoRecorder, DemoView
from stkzoo.evaluation.plotting import GRAY, INK, new_figure, save_figure, style_axes
from stkzoo.evaluation.ratings import Rating, rate, require_openskill
from stkzoo.evaluation.statistics import Estimate, percentile_interval
from stkzoo.evaluation.templates import render, require_jinja2
from stkzoo.evaluation.tournament.plan import TournamentPlan, plan_tournament
from stkzoo.evaluation.tournament.run import (
    load_tournament,
    resume_tournament,
    run_tournament,
    write_report,
)
from stkzoo.evaluation.tournament.schedule import ScheduledRace
from stkzoo.evaluation.tournament.standings import Standing, TournamentResult

__all__ = [
    "FORMS",
    "GRAY",
    "INK",
    "AgentReport",
    "AiTime",
    "AiTimes",
    "BatchAgent",
    "BatchError",
    "BatchProgress",
    "BenchmarkForm",
    "BenchmarkPlan",
    "BenchmarkRace",
    "BenchmarkResult",
    "Comparison",
    "DemoEpisode",
    "DemoPlan",
    "DemoRecorder",
    "DemoView",
    "Demonstrations",
    "EpisodeFacts",
    "Estimate",
    "KartOutcome",
    "RaceGroup",
    "RaceOutcome",
    "Rating",
    "RunOptions",
    "ScheduledRace",
    "Standing",
    "TournamentPlan",
    "TournamentResult",
    "check_agent",
    "compare",
    "load_ai_times",
    "load_benchmark",
    "load_demonstrations",
    "load_tournament",
    "new_figure",
    "percentile_interval",
    "plan_benchmark",
    "plan_demonstrations",
    "plan_time_trial",
    "plan_tournament",
    "plot_benchmark",
    "rate",
    "record_demonstrations",
    "render",
    "require_jinja2",
    "require_openskill",
    "resume_tournament",
    "run_benchmark",
    "run_time_trial",
    "run_tournament",
    "save_demonstrations",
    "save_figure",
    "style_axes",
    "write_report",
]
__dir__ = __all__.copy
