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

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from stkzoo._arguments import (
    CommandParser,
    add_options,
    changed_options,
    option,
    positional,
    values_of,
)
from stkzoo.cli._arguments import (
    BatchArguments,
    add_batch_options,
    chosen_directions,
    directions_option,
    refuse_options,
    usage_errors,
)
from stkzoo.errors import ConfigError
from stkzoo.race import RaceSettings

if TYPE_CHECKING:
    from stkzoo.evaluation import (
        BenchmarkPlan,
        BenchmarkResult,
        Comparison,
        Estimate,
        RaceGroup,
        TimeTrialPlan,
        TimeTrialResult,
    )

#: Options that are also arguments of ``plan_benchmark``.
_PLANNED = ("agent", "difficulty", "ai_times")
#: Options that only races of the usual benchmark have.
_CONDITIONS = ("difficulty", "forms", "directions", "ai_times")
_SEEDS, _TIME_TRIAL_SEEDS = 5, 1
_DIRECTIONS = ("forward", "reversed")
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
_TITLES = [title for title, _, _ in _COLUMNS.values()]


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
    directions: tuple[str, ...] = directions_option(*_DIRECTIONS)
    ai_times: str | None = option(metavar="FILE")
    output: str | None = option(metavar="PATH", group="output")
    json: bool = option(False, group="output")
    no_plot: bool = option(False, group="output")


def add_arguments(parser: CommandParser) -> None:
    """Declares the arguments."""
    from stkzoo.evaluation import BenchmarkPlan

    add_options(parser, BenchmarkArguments)
    add_batch_options(parser, BenchmarkPlan.decided)


@usage_errors
def run(arguments: argparse.Namespace) -> int:
    """Measures an agent or the game's AI, or compares results."""
    if arguments.time_trial:
        return _time_trial(arguments)
    if not arguments.compare and not arguments.baseline:
        return _benchmark(arguments)
    if arguments.agent:
        option = "--compare" if arguments.compare else "--baseline"
        raise ConfigError(f"{option} takes no agent; leave out {arguments.agent}")
    return _compare(arguments) if arguments.compare else _baseline(arguments)


def _benchmark(arguments: argparse.Namespace) -> int:
    from stkzoo.cli._batch import file_name, run_and_show
    from stkzoo.evaluation.benchmark.result import BENCHMARK

    plan = _plan(arguments)
    label = plan.agent.label
    folder = Path(arguments.output or Path("benchmark", file_name(label)))
    run = partial(BENCHMARK.run, plan, folder)
    return run_and_show(arguments, run, folder, lambda result: show_results([result]), label)


def _time_trial(arguments: argparse.Namespace) -> int:
    from stkzoo.cli._batch import file_name, run_and_show
    from stkzoo.evaluation.benchmark.time_trial import TIME_TRIALS

    plan = _time_trial_plan(arguments)
    label = plan.agent.label
    folder = Path(arguments.output or Path("benchmark", f"{file_name(label)}-time-trial"))
    run = partial(TIME_TRIALS.run, plan, folder)
    return run_and_show(arguments, run, folder, _show_time_trial, label)


def _time_trial_plan(arguments: argparse.Namespace) -> TimeTrialPlan:
    from stkzoo.evaluation import TimeTrialPlan, plan_time_trial

    _check_agent(arguments)
    refuse_options(
        "--time-trial has the conditions of the human records",
        *changed_options(arguments, BenchmarkArguments, only=_CONDITIONS),
    )
    return plan_time_trial(
        arguments.agent,
        split=_split(arguments, "all"),
        seeds=_seeds(arguments, _TIME_TRIAL_SEEDS),
        **values_of(arguments, RaceSettings, without=TimeTrialPlan.decided),
    )


def _check_agent(arguments: argparse.Namespace) -> None:
    if not arguments.agent:
        raise ConfigError("no agent; name one, such as heuristic, or see --help")


def _plan(arguments: argparse.Namespace) -> BenchmarkPlan:
    from stkzoo.evaluation import FORMS, BenchmarkPlan, plan_benchmark

    _check_agent(arguments)
    return plan_benchmark(
        split=_split(arguments, "test"),
        forms=arguments.forms or FORMS,
        reverse=chosen_directions(arguments),
        seeds=_seeds(arguments),
        **values_of(arguments, BenchmarkArguments, only=_PLANNED),
        **values_of(arguments, RaceSettings, without=BenchmarkPlan.decided),
    )


def _split(arguments: argparse.Namespace, default: str) -> str | Sequence[str]:
    names: Sequence[str] = arguments.split or [default]
    return names[0] if len(names) == 1 else names


def _seeds(arguments: argparse.Namespace, default: int = _SEEDS) -> int:
    return default if arguments.seeds is None else int(arguments.seeds)


def _baseline(arguments: argparse.Namespace) -> int:
    from stkzoo.cli._batch import run_and_show
    from stkzoo.cli._console import say
    from stkzoo.evaluation.benchmark.ai_times import AI_TIMES, plan_ai_times

    refuse_options(
        "--baseline has races of its own",
        *changed_options(arguments, BenchmarkArguments, only=_CONDITIONS),
        *_changed_settings(arguments),
    )
    plan = plan_ai_times(tracks=arguments.split or "all", seeds=_seeds(arguments))
    folder = Path(arguments.output or "ai-times")
    run = partial(AI_TIMES.run, plan, folder)
    return run_and_show(
        arguments, run, folder, lambda times: say(f"{len(times.by_race)} times of the game's AI")
    )


def _compare(arguments: argparse.Namespace) -> int:
    from stkzoo.cli._console import say
    from stkzoo.evaluation import compare, load_benchmark, plot_benchmark

    refuse_options(
        "--compare runs no races",
        *changed_options(
            arguments, BenchmarkArguments, only=(*_CONDITIONS, "split", "seeds", "no_plot")
        ),
        *changed_options(arguments, BatchArguments),
        *_changed_settings(arguments),
    )
    results = [load_benchmark(path) for path in arguments.compare]
    comparisons = [compare(results[0], other) for other in results[1:]]
    if arguments.output:
        plot_benchmark(results, arguments.output)
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


def _changed_settings(arguments: argparse.Namespace) -> list[str]:
    from stkzoo.evaluation import BenchmarkPlan

    return changed_options(arguments, RaceSettings, without=BenchmarkPlan.decided)


# ------------------------------------------------------------------ tables


def show_results(results: Sequence[BenchmarkResult]) -> None:
    """Prints the metrics of one agent, or the main metrics of several agents."""
    from stkzoo.cli._console import say

    is_one = len(results) == 1
    columns = [*([] if is_one else ["agent"]), "races on", "n", "chance"]
    rows, groups = [], []
    for result in results:
        label = result.label
        for group in result.groups:
            if group.by in (_SHOWN_GROUPS if is_one else _MAIN_GROUPS):
                chance = "-" if group.chance is None else f"{100 * group.chance:.0f}%"
                cells = (group.name or "all", str(group.races), chance)
                rows.append(cells if is_one else (label, *cells))
                groups.append(group)
                label = ""
    _show_figures(columns, rows, groups)
    _show_clustered(columns, rows, groups)
    for result in results:
        plan = result.plan
        errors = f"; the agent failed {result.errors} times" if result.errors else ""
        interval = "with" if plan.seeds > 1 else "--seeds 2 or more gives"
        say(
            f"{result.label}: {len(result.races)} of {len(plan.races())} races on "
            f"{', '.join(plan.tracks)}; AI difficulty {plan.settings.difficulty}; {interval} "
            f"95% intervals{errors}."
        )


def _show_time_trial(result: TimeTrialResult) -> None:
    """Prints an agent's times and the human records."""
    from stkzoo.cli._console import say, show_table
    from stkzoo.evaluation.benchmark.time_trial import CLOSE

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


def _show_comparison(comparison: Comparison) -> None:
    """Prints the differences between two agents."""
    from stkzoo.cli._console import say

    say(f"\n{comparison.first} minus {comparison.second}, in the same races:")
    groups = [group for group in comparison.differences if group.by in _SHOWN_GROUPS]
    rows = [(group.name or "all", str(group.races)) for group in groups]
    _show_figures(("races on", "n"), rows, groups, sign="+")
    _show_clustered(("races on", "n"), rows, groups, sign="+")


def _show_clustered(
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    groups: Sequence[RaceGroup],
    sign: str = "",
) -> None:
    """Prints the intervals over tracks and directions of all races and of the forms.

    Args:
        columns: as for :func:`_show_figures`.
        rows: as for :func:`_show_figures`.
        groups: as for :func:`_show_figures`.
        sign: as for :func:`_show_figures`.
    """
    from stkzoo.cli._console import say

    main = [(row, g) for row, g in zip(rows, groups, strict=True) if g.by in _MAIN_GROUPS]
    if not any(e is not None and e.low is not None for _, g in main for e in g.clustered.values()):
        return  # too few tracks
    say("\nThe same means, with intervals over tracks and directions and the AI's times resampled:")
    clustered = [replace(group, figures=group.clustered) for _, group in main]
    _show_figures(columns, [row for row, _ in main], clustered, sign)


def _show_figures(
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    groups: Sequence[RaceGroup],
    sign: str = "",
) -> None:
    """Prints a table with the metrics of groups of races.

    Args:
        columns: headings of the first columns.
        rows: texts of the first columns, for each group.
        groups: the groups.
        sign: sign option for formatting numbers; ``"+"`` shows the sign of positive ones.
    """
    from stkzoo.cli._console import make_console, show_table

    console = make_console()
    is_wide = not console.is_terminal or console.width >= _WIDTH
    show_table(
        (*columns, *_TITLES),
        [(*row, *_cells(g.figures, is_wide, sign)) for row, g in zip(rows, groups, strict=True)],
        left=("agent", "races on"),
        styles=["bold" if group.by == "all" else None for group in groups],
        console=console,
    )


def _cells(figures: Mapping[str, Estimate | None], is_wide: bool, sign: str = "") -> list[str]:
    return [
        _cell(figures[name], scale, f"{sign}.{decimals}f", is_wide)
        for name, (_, scale, decimals) in _COLUMNS.items()
    ]


def _cell(estimate: Estimate | None, scale: float, spec: str, is_wide: bool) -> str:
    if estimate is None:
        return "-"
    value = format(scale * estimate.value, spec)
    if estimate.low is None or estimate.high is None:
        return value
    low, high = (format(scale * end, spec) for end in estimate.interval)
    return f"{value} ({low}..{high})" if is_wide else f"{value}\n{low}..{high}"
