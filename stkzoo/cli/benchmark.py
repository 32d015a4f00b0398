"""Measure how good an agent is.

Measures an agent in races that are the same for all agents: on the test tracks, forward and
reversed, alone (P), as one kart against four of the game's AI (PAAAA), and as two karts against
three (PPAAA), from both ends of the grid. The results are the agent's time as a multiple of the
AI's median time, its win rate, its mean rank, the share of races that it did not finish, and its
number of rescues per race, each with a 95% interval.

With --time-trial, the agent instead drives each track alone under the conditions of the human
world records: time trial, forward, difficulty 3, kart pidgin, as many laps as the record. The
results are its times as multiples of the records.

Each race is stored in the output folder as soon as it ends. After an interruption, the same
command resumes.

Name the agent as for `stkzoo race`: heuristic, ai, random, a folder, a zip or a module; append
@:Name to rename it.

Examples:
  stkzoo benchmark heuristic                  300 races
  stkzoo benchmark my_agent/ --track lighthouse hacienda --seeds 2
  stkzoo benchmark my_agent.zip --difficulty 2 --output results/mine --inline
  stkzoo benchmark heuristic --time-trial     21 races against human records
  stkzoo benchmark --compare results/mine benchmark/heuristic

exit codes:
  0 success, 1 a race could not be run, 2 invalid command line, 3 the agent
  failed in some race, 130 interrupted
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stkzoo import evaluation
from stkzoo._arguments import changed_options, option, options_of, positional, refuse_options
from stkzoo.cli._batch import RUN_OPTIONS, directions_option, file_name, reverse_of, run_and_show
from stkzoo.cli._console import counted, say, show, show_facts
from stkzoo.errors import ConfigError
from stkzoo.evaluation.benchmark.result import BENCHMARK
from stkzoo.race import RaceSettings

#: Options that only races of the usual benchmark have.
_CONDITIONS = ("difficulty", "forms", "directions")
_MAIN_GROUPS = ("all", "form")
_SHOWN_GROUPS = (*_MAIN_GROUPS, "direction", "end", "track")
#: Estimates of metrics by name.
_Figures = Mapping[str, evaluation.Estimate | None]


@dataclass
class BenchmarkArguments:
    """Options of ``stkzoo benchmark``.

    Attributes:
        agent: the agent; see above
        compare: compare results (folders or result.json files): the first with each of the others
        time_trial: drive each track alone in the game's time trial, against the human records
        split: names of tracks, or train, train_only, validation, test or all (default: test;
            with --time-trial, all)
        difficulty: skill of the game's AI and speed of all karts, 0 to 3
        forms: line-ups to race: P is a kart of the agent, A one of the AI (default: PAAAA PPAAA P)
        seeds: races of each track, direction, line-up and end of the grid (default: 5; with
            --time-trial, 1)
        output: folder for the races, result.json and benchmark.png (default: benchmark/AGENT, or
            benchmark/AGENT-time-trial); with --compare, a file for the plot
        json: write only JSON to stdout
        no_plot: do not draw benchmark.png
    """

    agent: str | None = positional(None)
    compare: tuple[str, ...] | None = option(metavar="RESULT", rivals="what")
    time_trial: bool = option(False, rivals="what")
    split: tuple[str, ...] | None = option(flag="--track", metavar="TRACK")
    difficulty: int = 3
    forms: tuple[str, ...] | None = option(metavar="FORM")
    seeds: int | None = None
    directions: tuple[str, ...] = directions_option("forward", "reversed")
    output: str | None = option(metavar="PATH", group="output")
    json: bool = option(False, group="output")
    no_plot: bool = option(False, group="output")
    batch: dict[str, Any] = options_of(evaluation.RunOptions, only=RUN_OPTIONS)
    settings: dict[str, Any] = options_of(
        RaceSettings, without=evaluation.BenchmarkPlan.decided, group="each race"
    )


def run(arguments: BenchmarkArguments) -> int:
    """Measures an agent, or compares results."""
    if arguments.compare:
        return _compare(arguments)
    if arguments.agent is None:
        raise ConfigError("no agent; name one, such as heuristic, or see --help")
    plan_races = _plan_time_trial if arguments.time_trial else _plan_benchmark
    plan = plan_races(arguments, arguments.agent)
    kind = "-time-trial" if arguments.time_trial else ""
    folder = Path(arguments.output or f"benchmark/{file_name(plan.agent.label)}{kind}")
    return run_and_show(arguments, BENCHMARK, plan, folder, lambda result: show_results([result]))


def _plan_benchmark(arguments: BenchmarkArguments, agent: str) -> evaluation.BenchmarkPlan:
    return evaluation.plan_benchmark(
        agent,
        difficulty=arguments.difficulty,
        reverse=reverse_of(arguments.directions),
        **_chosen(split=arguments.split, forms=arguments.forms, seeds=arguments.seeds),
        **arguments.settings,
    )


def _plan_time_trial(arguments: BenchmarkArguments, agent: str) -> evaluation.BenchmarkPlan:
    refuse_options(
        "--time-trial has the conditions of the human records",
        changed_options(arguments, only=_CONDITIONS),
    )
    chosen = _chosen(split=arguments.split, seeds=arguments.seeds)
    return evaluation.plan_time_trial(agent, **chosen, **arguments.settings)


def _chosen(**options: Any) -> dict[str, Any]:
    """Returns the options that the user chose."""
    return {name: value for name, value in options.items() if value is not None}


def _compare(arguments: BenchmarkArguments) -> int:
    if arguments.agent is not None:
        raise ConfigError(f"--compare takes no agent; leave out {arguments.agent}")
    refuse_options(
        "--compare runs no races", changed_options(arguments, without=("compare", "output", "json"))
    )
    results = [evaluation.load_benchmark(path) for path in arguments.compare or ()]
    comparisons = [evaluation.compare(results[0], other) for other in results[1:]]
    if arguments.output:
        evaluation.plot_benchmark(results, arguments.output)
    show(
        [*results, *comparisons],
        lambda _: _show_comparisons(results, comparisons),
        as_json=arguments.json,
    )
    if arguments.output and not arguments.json:
        say(f"Drawn in {arguments.output}")
    return 0


# ------------------------------------------------------------------ tables


def show_results(results: Sequence[evaluation.BenchmarkResult]) -> None:
    """Prints the metrics of one agent, or the main metrics of several agents."""
    shown = _SHOWN_GROUPS if len(results) == 1 else _MAIN_GROUPS
    groups = [(result.label, g) for result in results for g in result.groups if g.by in shown]
    _show_groups(groups)
    for result in results:
        plan = result.plan
        errors = f"; the agent failed {counted(result.errors, 'time')}" if result.errors else ""
        interval = "with" if plan.seeds > 1 else "--seeds 2 or more gives"
        say(
            f"{result.label}: {len(result.races)} of {counted(len(plan.races()), 'race')} on "
            f"{', '.join(plan.tracks)}; difficulty {plan.settings.difficulty}; {interval} "
            f"95% intervals{errors}."
        )


def _show_comparisons(
    results: Sequence[evaluation.BenchmarkResult], comparisons: Sequence[evaluation.Comparison]
) -> None:
    """Prints the main metrics of several agents, and the differences between them."""
    show_results(results)
    for comparison in comparisons:
        say(f"\n{comparison.first} minus {comparison.second}, in the same races:")
        _show_groups([("", group) for group in comparison.differences if group.by in _SHOWN_GROUPS])


def _show_groups(groups: Sequence[tuple[str, evaluation.RaceGroup]]) -> None:
    """Prints the metrics of groups of races.

    A second table has the intervals over tracks and directions of all races and of the forms.

    Args:
        groups: the groups, each after the name of its agent.
    """
    _show_figures([(agent, group, group.figures) for agent, group in groups])
    clustered = [(a, group, group.clustered) for a, group in groups if group.by in _MAIN_GROUPS]
    estimates = [estimate for *_, figures in clustered for estimate in figures.values()]
    if any(estimate is not None and estimate.low is not None for estimate in estimates):
        say("\nThe same means, with intervals over tracks and directions:")
        _show_figures(clustered)


def _show_figures(groups: Sequence[tuple[str, evaluation.RaceGroup, _Figures]]) -> None:
    """Prints a table of figures of groups, each after the name of its agent."""
    rows = []
    for agent, group, figures in groups:
        head = {"agent": agent, "races on": group.name or "all", "n": group.races}
        rows.append({**head, "chance": group.chance, **figures})
    styles = ["bold" if group.by == "all" else None for _, group, _ in groups]
    show_facts(rows, styles=styles)
