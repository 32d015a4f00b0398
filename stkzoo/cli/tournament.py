"""Rate agents in many races.

Runs many races among agents and rates them. The schedule is balanced: each agent races as
often as the others, on each track, from each place of the grid, against each other agent.

Each race is stored in the output folder as soon as it is over. After an interruption the same
command resumes; so does --resume FOLDER. An agent that fails loses its race; the tournament
goes on.

Agents are named as for `stkzoo race`: ai, heuristic, random, a folder, a zip, a module; append
@:Name to rename one.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from stkzoo.cli._arguments import add_batch_options, add_tracks, settings_of, usage_errors
from stkzoo.errors import ConfigError

if TYPE_CHECKING:
    from stkzoo.evaluation import RunOptions, TournamentResult

EXAMPLES = """\
examples:
  stkzoo tournament heuristic ai random my_agent/ --tracks lighthouse hacienda
  stkzoo tournament students/*.zip ai --tracks test --races 300 --per-race 5 --output league
  stkzoo tournament --resume league

exit codes:
  0 success, 1 a race could not be run, 2 invalid command line, 3 an agent failed in some race,
  130 interrupted
"""

_DECIDED = ("track", "seed")
_AGENT_FAILED = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments."""
    parser.add_argument("agents", nargs="*", metavar="AGENT", help="the agents; see above")
    add_tracks(parser)
    for option, default, text in (
        ("--races", 60, "number of races (default: %(default)s)"),
        ("--per-race", None, "agents in a race (default: 4, or all if there are fewer)"),
        ("--seed", 0, "of the schedule and the races (default: %(default)s)"),
    ):
        parser.add_argument(option, type=int, default=default, metavar="N", help=text)
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument(
        "--output",
        default="tournament",
        metavar="FOLDER",
        help="for races, result.json and tournament.png (default: %(default)s)",
    )
    choice.add_argument("--resume", metavar="FOLDER", help="resume the tournament in FOLDER")
    parser.add_argument("--json", action="store_true", help="write only JSON to stdout")
    parser.add_argument("--no-plot", action="store_true", help="draw no tournament.png")
    add_batch_options(parser, _DECIDED)


@usage_errors
def run(arguments: argparse.Namespace) -> int:
    """Runs or resumes a tournament."""
    from stkzoo.cli._batch import run_batch, say_kept

    folder = Path(arguments.resume or arguments.output)
    result, code = run_batch(
        arguments,
        lambda options: _run(arguments, folder, options),
        f"stkzoo tournament --resume {folder}",
    )
    if result is None:
        return code
    if arguments.json:
        print(result.to_json())
    else:
        _show(result)
        say_kept(folder, "result.json", "tournament.png", "races")
    has_failed = any(row.errors for row in result.standings)
    return code or (_AGENT_FAILED if has_failed else 0)


def _run(arguments: argparse.Namespace, folder: Path, options: RunOptions) -> TournamentResult:
    from stkzoo.evaluation import plan_tournament
    from stkzoo.evaluation.tournament.run import resumed_plan, run_tournament_plan

    if arguments.resume and arguments.agents:
        raise ConfigError("--resume knows its agents; leave them out")
    plan = (
        resumed_plan(folder)
        if arguments.resume
        else plan_tournament(
            arguments.agents,
            tracks=arguments.tracks,
            races=arguments.races,
            per_race=arguments.per_race,
            seed=arguments.seed,
            **settings_of(arguments, _DECIDED),
        )
    )
    return run_tournament_plan(plan, folder, options, plot=not arguments.no_plot)


def _show(result: TournamentResult) -> None:
    from rich.console import Console
    from rich.markup import escape

    from stkzoo.cli._console import make_table, say

    console = Console()
    columns = ("place", "agent", "rating", "95 %", "races", "wins", "rank", "finished", "failed")
    table = make_table(columns, ("agent",), is_framed=console.is_terminal)
    for row in result.standings:
        rating = row.rating
        table.add_row(
            str(row.place),
            escape(row.label),
            f"{rating.value:.1f}",
            f"{rating.low:.1f} to {rating.high:.1f}",
            str(row.races),
            str(row.wins),
            "-" if row.mean_rank is None else f"{row.mean_rank:.2f}",
            str(row.finished),
            str(row.retired),
            style="red" if row.errors else None,
        )
    console.print(table)
    plan = result.plan
    say(
        f"{len(result.races)} of {plan.races} races of {plan.per_race} on "
        f"{', '.join(plan.tracks)}; Plackett-Luce ratings, intervals by bootstrap over races."
    )
