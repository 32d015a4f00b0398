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
  stkzoo benchmark --baseline --output ai-times     the AI's times

exit codes:
  0 success, 1 a race could not be run, 2 invalid command line, 3 the agent
  failed in some race, 130 interrupted
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stkzoo import evaluation
from stkzoo._arguments import changed_options, option, options_of, positional, refuse_options
from stkzoo.cli._batch import (
    BatchArguments,
    directions_option,
    file_name,
    reverse_of,
    run_and_show,
)
from stkzoo.cli._console import make_console, say, show_table
from stkzoo.errors import ConfigError
from stkzoo.evaluation.benchmark.ai_times import AI_TIMES, plan_ai_times
from stkzoo.evaluation.benchmark.result import BENCHMARK
from stkzoo.evaluation.benchmark.time_trial import CLOSE, TIME_TRIALS
from stkzoo.race import RaceSettings

#: Options that only races of the usual benchmark have.
_CONDITIONS = ("difficulty", "forms", "directions", "ai_times")
_SEEDS, _TIME_TRIAL_SEEDS = 5, 1
_MAIN_GROUPS = ("all", "form")
_SHOWN_GROUPS = (*_MAIN_GROUPS, "direction", "end", "track")
#: Width of a line with all metrics. On a narrower terminal, intervals are printed below values.
_WIDTH = 145
#: Title, factor and number of decimals of each metric.
_COLUMNS = {
    "time_ratio": ("time ratio", 1, 3),
    "win_rate": ("won %", 100, 1),
    "mean_rank": ("rank", 1, 2),
    "unfinished": ("DNF %", 100, 1),
    "rescues": ("rescues", 1, 2),
}
#: A group of races, after the texts of its first columns in a table.
_Row = tuple[Sequence[str], evaluation.RaceGroup]


@dataclass
class BenchmarkArguments:
    """Options of ``stkzoo benchmark``.

    Attributes:
        agent: the agent; see above
        compare: compare results (folders or result.json files): the first with each of the others
        time_trial: drive each track alone in the game's time trial, against the human records
        baseline: measure the game's AI at all difficulties, for --ai-times
        split: names of tracks, or train, train_only, validation, test or all (default: test;
            with --time-trial or --baseline, all)
        difficulty: difficulty of the game's AI, 0 to 3
        forms: line-ups to race: P is a kart of the agent, A one of the AI (default: PAAAA PPAAA P)
        seeds: races of each track, direction, line-up and end of the grid (default: 5; with
            --time-trial, 1)
        ai_times: the AI's times, from --baseline (default: those that come with stkzoo)
        output: folder for the races, result.json and benchmark.png (default: benchmark/AGENT, or
            benchmark/AGENT-time-trial); with --compare, a file for the plot; with --baseline, a
            folder for the times
        json: write only JSON to stdout
        no_plot: do not draw benchmark.png
    """

    agent: str | None = positional(None)
    compare: tuple[str, ...] | None = option(metavar="RESULT", rivals="what")
    time_trial: bool = option(False, rivals="what")
    baseline: bool = option(False, rivals="what")
    split: tuple[str, ...] | None = option(flag="--track", metavar="TRACK")
    difficulty: int = 3
    forms: tuple[str, ...] | None = option(metavar="FORM")
    seeds: int | None = None
    directions: tuple[str, ...] = directions_option("forward", "reversed")
    ai_times: str | None = option(metavar="FILE")
    output: str | None = option(metavar="PATH", group="output")
    json: bool = option(False, group="output")
    no_plot: bool = option(False, group="output")
    batch: BatchArguments = options_of(BatchArguments)
    settings: dict[str, Any] = options_of(
        RaceSettings, without=evaluation.BenchmarkPlan.decided, group="each race"
    )


def run(arguments: BenchmarkArguments) -> int:
    """Measures an agent or the game's AI, or compares results."""
    if arguments.agent is None:
        if arguments.compare:
            return _compare(arguments)
        if arguments.baseline:
            return _baseline(arguments)
        raise ConfigError("no agent; name one, such as heuristic, or see --help")
    if arguments.compare or arguments.baseline:
        mode = "--compare" if arguments.compare else "--baseline"
        raise ConfigError(f"{mode} takes no agent; leave out {arguments.agent}")
    return (_time_trial if arguments.time_trial else _benchmark)(arguments, arguments.agent)


def _benchmark(arguments: BenchmarkArguments, agent: str) -> int:
    plan = evaluation.plan_benchmark(
        agent,
        split=_split(arguments, "test"),
        difficulty=arguments.difficulty,
        forms=arguments.forms or evaluation.FORMS,
        reverse=reverse_of(arguments.directions),
        seeds=_seeds(arguments),
        ai_times=arguments.ai_times,
        **arguments.settings,
    )
    folder = Path(arguments.output or Path("benchmark", file_name(plan.agent.label)))
    return run_and_show(
        arguments, BENCHMARK.run, plan, folder, lambda result: show_results([result])
    )


def _time_trial(arguments: BenchmarkArguments, agent: str) -> int:
    refuse_options(
        "--time-trial has the conditions of the human records",
        changed_options(arguments, only=_CONDITIONS),
    )
    plan = evaluation.plan_time_trial(
        agent,
        split=_split(arguments, "all"),
        seeds=_seeds(arguments, _TIME_TRIAL_SEEDS),
        **arguments.settings,
    )
    name = f"{file_name(plan.agent.label)}-time-trial"
    folder = Path(arguments.output or Path("benchmark", name))
    return run_and_show(arguments, TIME_TRIALS.run, plan, folder, _show_time_trial)


def _split(arguments: BenchmarkArguments, default: str) -> str | Sequence[str]:
    names: Sequence[str] = arguments.split or [default]
    return names[0] if len(names) == 1 else names


def _seeds(arguments: BenchmarkArguments, default: int = _SEEDS) -> int:
    return default if arguments.seeds is None else arguments.seeds


def _baseline(arguments: BenchmarkArguments) -> int:
    refuse_options(
        "--baseline has races of its own",
        changed_options(arguments, only=(*_CONDITIONS, "settings")),
    )
    plan = plan_ai_times(tracks=arguments.split or "all", seeds=_seeds(arguments))
    folder = Path(arguments.output or "ai-times")
    return run_and_show(
        arguments,
        AI_TIMES.run,
        plan,
        folder,
        lambda times: say(f"{len(times.by_race)} times of the game's AI"),
    )


def _compare(arguments: BenchmarkArguments) -> int:
    refuse_options(
        "--compare runs no races", changed_options(arguments, without=("compare", "output", "json"))
    )
    results = [evaluation.load_benchmark(path) for path in arguments.compare or ()]
    comparisons = [evaluation.compare(results[0], other) for other in results[1:]]
    if arguments.output:
        evaluation.plot_benchmark(results, arguments.output)
    if arguments.json:
        texts = [result.to_json() for result in results]
        texts += [comparison.to_json() for comparison in comparisons]
        print("[" + ",\n".join(texts) + "]")
        return 0
    show_results(results)
    for comparison in comparisons:
        _show_comparison(comparison)
    if arguments.output:
        say(f"Drawn in {arguments.output}")
    return 0


# ------------------------------------------------------------------ tables


def show_results(results: Sequence[evaluation.BenchmarkResult]) -> None:
    """Prints the metrics of one agent, or the main metrics of several agents."""
    is_one = len(results) == 1
    columns = [*([] if is_one else ["agent"]), "races on", "n", "chance"]
    rows = []
    for result in results:
        label = result.label
        for group in result.groups:
            if group.by in (_SHOWN_GROUPS if is_one else _MAIN_GROUPS):
                chance = "-" if group.chance is None else f"{100 * group.chance:.0f}%"
                cells = (group.name or "all", str(group.races), chance)
                rows.append((cells if is_one else (label, *cells), group))
                label = ""
    _show_groups(columns, rows)
    for result in results:
        plan = result.plan
        errors = f"; the agent failed {result.errors} times" if result.errors else ""
        interval = "with" if plan.seeds > 1 else "--seeds 2 or more gives"
        say(
            f"{result.label}: {len(result.races)} of {len(plan.races())} races on "
            f"{', '.join(plan.tracks)}; AI difficulty {plan.settings.difficulty}; {interval} "
            f"95% intervals{errors}."
        )


def _show_time_trial(result: evaluation.TimeTrialResult) -> None:
    """Prints an agent's times and the human records."""
    rows = [
        (
            track.track,
            str(track.laps),
            "-" if track.time is None else f"{track.time:.2f}",
            f"{track.record:.2f}",
            f"{track.ratio:.3f}",
        )
        for track in result.tracks
    ]
    show_table(
        ("track", "laps", "time [s]", "record [s]", "ratio"),
        rows,
        left=("track",),
        caption="ratio: multiple of the human record",
    )
    if result.mean_ratio is not None:
        say(
            f"{result.label}: mean ratio {result.mean_ratio:.3f} on {len(result.tracks)} tracks; "
            f"{result.close} at {CLOSE} or less; unfinished: {', '.join(result.unfinished) or '-'}."
        )


def _show_comparison(comparison: evaluation.Comparison) -> None:
    """Prints the differences between two agents."""
    say(f"\n{comparison.first} minus {comparison.second}, in the same races:")
    groups = (group for group in comparison.differences if group.by in _SHOWN_GROUPS)
    rows = [((group.name or "all", str(group.races)), group) for group in groups]
    _show_groups(("races on", "n"), rows, sign="+")


def _show_groups(columns: Sequence[str], rows: Sequence[_Row], sign: str = "") -> None:
    """Prints the metrics of groups of races.

    A second table has the intervals over tracks and directions of all races and of the forms.

    Args:
        columns: headings of the first columns.
        rows: the groups, and the texts of their first columns.
        sign: sign option for formatting numbers; ``"+"`` shows the sign of positive ones.
    """
    _show_figures(columns, rows, sign)
    main = [(cells, group) for cells, group in rows if group.by in _MAIN_GROUPS]
    if not any(e is not None and e.low is not None for _, g in main for e in g.clustered.values()):
        return  # too few tracks
    say("\nThe same means, with intervals over tracks and directions:")
    clustered = [(cells, replace(group, figures=group.clustered)) for cells, group in main]
    _show_figures(columns, clustered, sign)


def _show_figures(columns: Sequence[str], rows: Sequence[_Row], sign: str) -> None:
    """Prints a table; see :func:`_show_groups`."""
    console = make_console()
    is_wide = not console.is_terminal or console.width >= _WIDTH
    show_table(
        (*columns, *(title for title, _, _ in _COLUMNS.values())),
        [(*cells, *_cells(group, is_wide, sign)) for cells, group in rows],
        left=("agent", "races on"),
        styles=["bold" if group.by == "all" else None for _, group in rows],
        console=console,
    )


def _cells(group: evaluation.RaceGroup, is_wide: bool, sign: str) -> list[str]:
    return [
        _cell(group.figures[name], scale, f"{sign}.{decimals}f", is_wide)
        for name, (_, scale, decimals) in _COLUMNS.items()
    ]


def _cell(estimate: evaluation.Estimate | None, scale: float, spec: str, is_wide: bool) -> str:
    if estimate is None:
        return "-"
    value = format(scale * estimate.value, spec)
    if estimate.low is None or estimate.high is None:
        return value
    low, high = (format(scale * end, spec) for end in estimate.interval)
    return f"{value} ({low}..{high})" if is_wide else f"{value}\n{low}..{high}"
