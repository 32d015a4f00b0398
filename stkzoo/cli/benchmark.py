"""``stkzoo benchmark``: how good an agent is."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stkzoo.cli.batch_bar import BatchBar
from stkzoo.cli.flags import add_flags, flags_given

if TYPE_CHECKING:
    from stkzoo.evaluation import BenchmarkPlan, BenchmarkResult

__all__ = ["add_parser"]

_ABOUT = """\
Measures an agent by the same races as everybody: on the test tracks, forward and reversed,
alone (P), as one kart among four of the game's AI (PAAAA), and as two among three (PPAAA),
from both ends of the grid. It shows its time as a multiple of the AI's median time there, the
races it won, its mean rank, how often it did not finish and was rescued, each with a 95 %
interval.

Each race is kept in the output folder as soon as it is over. If the benchmark is interrupted,
by whatever, the same command goes on where it was.

The agent is named as for `stkzoo race`: heuristic, ai, random, a folder, a zip, a module, with
@:Name behind it to call it something else.
"""

_EXAMPLES = """\
examples:
  stkzoo benchmark heuristic                    300 races, kept in benchmark/heuristic
  stkzoo benchmark my_agent/ --split lighthouse hacienda --seeds 2
  stkzoo benchmark my_agent.zip --difficulty 2 --output results/mine --inline
  stkzoo benchmark --compare results/mine benchmark/heuristic
  stkzoo benchmark --baseline --output ai-times     the AI's own times, measured anew

exit codes:
  0 all is well, 1 a race could not be run, 2 the command cannot be understood,
  3 the agent failed in some race, 130 interrupted
"""

_AGENT_FAILED, _INTERRUPTED = 3, 130
_DIRECTIONS = {"forward": False, "reversed": True}


def add_parser(subparsers: argparse._SubParsersAction[Any]) -> None:
    """Adds the command."""
    from stkzoo.race import RaceSettings

    parser = subparsers.add_parser(
        "benchmark",
        help="measure how good an agent is",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("agent", nargs="?", metavar="AGENT", help="who is measured; see above")
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument(
        "--compare",
        nargs="+",
        metavar="RESULT",
        help="show what was measured in these folders or result.json files, and by how much "
        "the first differs from the others in the same races",
    )
    choice.add_argument(
        "--baseline",
        action="store_true",
        help="measure the game's AI itself, at all difficulties, for --ai-times",
    )
    _add_races(parser)
    parser.add_argument(
        "--output",
        metavar="FOLDER",
        help="where races, result.json and benchmark.png are kept (default: benchmark/AGENT); with "
        "--compare, a picture's file",
    )
    parser.add_argument("--json", action="store_true", help="write only JSON to stdout")
    parser.add_argument("--no-plot", action="store_true", help="draw no benchmark.png")
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="races at a time (default: as many as processors)"
    )
    parser.add_argument(
        "--race-timeout",
        type=float,
        default=3600.0,
        metavar="SECONDS",
        help="for one race (default: %(default)s)",
    )
    add_flags(parser.add_argument_group("each race"), RaceSettings, leave_out=_decided())
    parser.set_defaults(run=_run, fail=parser.error)


def _decided() -> tuple[str, ...]:
    from stkzoo.evaluation.benchmark.races import DECIDED

    return DECIDED


def _add_races(parser: argparse.ArgumentParser) -> None:
    from stkzoo.evaluation.benchmark.races import FORMS

    parser.add_argument(
        "--split",
        nargs="+",
        metavar="TRACK",
        help="test, train, all, or names of tracks (default: test; with --baseline all)",
    )
    parser.add_argument(
        "--difficulty",
        type=int,
        default=3,
        metavar="N",
        help="of the game's AI, 0 to 3 (default: %(default)s)",
    )
    parser.add_argument(
        "--forms",
        nargs="+",
        default=list(FORMS),
        metavar="FORM",
        help=f"P is a kart of the agent, A one of the AI (default: {' '.join(FORMS)})",
    )
    parser.add_argument(
        "--seeds",
        type=int,
        default=5,
        metavar="N",
        help="races of each kind (default: %(default)s)",
    )
    parser.add_argument(
        "--directions",
        nargs="+",
        default=list(_DIRECTIONS),
        choices=list(_DIRECTIONS),
        help="default: both",
    )
    parser.add_argument(
        "--ai-times", metavar="FILE", help="what --baseline wrote (default: stkzoo's own)"
    )


def _run(arguments: argparse.Namespace) -> int:
    from stkzoo.errors import ConfigError

    try:
        if arguments.compare:
            return _compare(arguments)
        if arguments.baseline:
            return _baseline(arguments)
        return _benchmark(arguments)
    except ConfigError as error:
        arguments.fail(str(error))
        raise  # not reached: fail() leaves


# ------------------------------------------------------------------ one agent


def _benchmark(arguments: argparse.Namespace) -> int:
    from stkzoo.evaluation import BatchError, RunOptions
    from stkzoo.evaluation.benchmark.run import run_benchmark_plan

    plan = _plan(arguments)
    folder = Path(arguments.output or Path("benchmark", plan.agent.label.replace("/", "_")))
    code = 0
    with BatchBar() as bar:
        try:
            options = RunOptions(arguments.jobs, arguments.race_timeout, bar.tell)
            result = run_benchmark_plan(plan, folder, options, plot=not arguments.no_plot)
        except BatchError as error:
            print(f"stkzoo: {error}", file=sys.stderr)
            result, code = error.result, 1
        except KeyboardInterrupt:
            return _interrupted(bar, "give the same command again")
    if arguments.json:
        print(result.to_json())
    else:
        _show([result])
        names = ("result.json", "benchmark.png", "races")
        kept = ", ".join(name for name in names if (folder / name).exists())
        _say(f"More in {folder}{os.sep}: {kept}")
    return code or (_AGENT_FAILED if result.errors else 0)


def _plan(arguments: argparse.Namespace) -> BenchmarkPlan:
    from stkzoo.errors import ConfigError
    from stkzoo.evaluation import plan_benchmark
    from stkzoo.race import RaceSettings

    if not arguments.agent:
        raise ConfigError("no agent; name one, such as heuristic, or see --help")
    split = arguments.split or ["test"]
    return plan_benchmark(
        arguments.agent,
        split=split[0] if len(split) == 1 else split,
        difficulty=arguments.difficulty,
        forms=arguments.forms,
        seeds=arguments.seeds,
        reverse=[_DIRECTIONS[name] for name in arguments.directions],
        ai_times=arguments.ai_times,
        settings=RaceSettings(**flags_given(arguments, RaceSettings, leave_out=_decided())),
    )


def _interrupted(bar: BatchBar, how: str) -> int:
    print(
        f"stkzoo: interrupted after {bar.done} of {bar.total} races, which are kept; to go on, "
        f"{how}",
        file=sys.stderr,
    )
    return _INTERRUPTED


# ------------------------------------------------------------------ the AI's times


def _baseline(arguments: argparse.Namespace) -> int:
    from stkzoo.errors import ConfigError
    from stkzoo.evaluation import measure_ai_times
    from stkzoo.evaluation.benchmark.ai_times import AI_TIMES_FILE

    if arguments.agent:
        raise ConfigError("--baseline measures the game's AI; leave the agent out")
    folder = Path(arguments.output or "ai-times")
    with BatchBar() as bar:
        try:
            times = measure_ai_times(
                folder,
                tracks=arguments.split or "all",
                seeds=arguments.seeds,
                jobs=arguments.jobs,
                race_timeout=arguments.race_timeout,
                on_race=bar.tell,
            )
        except KeyboardInterrupt:
            return _interrupted(bar, "give the same command again")
    if arguments.json:
        print(times.to_json())
    else:
        _say(f"{len(times.by_race)} times of the game's AI in {folder / AI_TIMES_FILE}")
    return 0


# ------------------------------------------------------------------ several results


def _compare(arguments: argparse.Namespace) -> int:
    from stkzoo.errors import ConfigError
    from stkzoo.evaluation import compare, load_benchmark, plot_benchmark

    if arguments.agent:
        raise ConfigError("--compare knows its agents; leave the agent out")
    results = [load_benchmark(path) for path in arguments.compare]
    comparisons = [compare(results[0], other) for other in results[1:]]
    if arguments.output:
        plot_benchmark(results, arguments.output)
    if arguments.json:
        texts = [result.to_json() for result in results]
        texts += [comparison.to_json() for comparison in comparisons]
        print("[" + ",\n".join(texts) + "]")
        return 0
    _show(results)
    from stkzoo.cli.benchmark_report import show_comparison

    for comparison in comparisons:
        show_comparison(comparison)
    if arguments.output:
        _say(f"Drawn in {arguments.output}")
    return 0


def _show(results: Sequence[BenchmarkResult]) -> None:
    from stkzoo.cli.benchmark_report import show_results

    show_results(results)


def _say(text: str) -> None:
    from rich.console import Console

    Console().print(text, highlight=False, markup=False, soft_wrap=True)
