"""``stkzoo tournament``: find out which agents are better."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stkzoo.cli.batch_bar import BatchBar
from stkzoo.cli.flags import add_flags, flags_given

if TYPE_CHECKING:
    from stkzoo.evaluation import TournamentResult

__all__ = ["add_parser"]

_ABOUT = """\
Runs many races among agents and rates them. The schedule is balanced: each agent races as
often as the others, on each track, from each place of the grid, against each other agent.

Each race is kept in the output folder as soon as it is over. If the tournament is
interrupted, by whatever, the same command goes on where it was; so does --resume FOLDER.
An agent that fails loses its race; the tournament goes on.

agents are named as for `stkzoo race`: ai, heuristic, random, a folder, a zip, a module, with
@:Name behind it to call it something else.
"""

_EXAMPLES = """\
examples:
  stkzoo tournament heuristic ai random my_agent/ --tracks lighthouse hacienda
  stkzoo tournament students/*.zip ai --tracks test --races 300 --per-race 5 --output league
  stkzoo tournament --resume league

exit codes:
  0 all is well, 1 a race could not be run, 2 the command cannot be understood,
  3 an agent failed in some race, 130 interrupted
"""

_LEFT_OUT = ("track", "seed")
_AGENT_FAILED, _INTERRUPTED = 3, 130
_FOLDER = "tournament"


def add_parser(subparsers: argparse._SubParsersAction[Any]) -> None:
    """Adds the command."""
    from stkzoo.race import RaceSettings

    parser = subparsers.add_parser(
        "tournament",
        help="rate agents in many races",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("agents", nargs="*", metavar="AGENT", help="who takes part; see above")
    parser.add_argument(
        "--tracks",
        nargs="+",
        default=["train"],
        metavar="TRACK",
        help="names of tracks, or train, test or all (default: train)",
    )
    for flag, default, text in (
        ("--races", 60, "how many races (default: %(default)s)"),
        ("--per-race", None, "agents in a race (default: 4, or all if they are fewer)"),
        ("--seed", 0, "decides the schedule and the races (default: %(default)s)"),
        ("--jobs", None, "races at a time (default: as many as processors)"),
    ):
        parser.add_argument(flag, type=int, default=default, metavar="N", help=text)
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument(
        "--output",
        default=_FOLDER,
        metavar="FOLDER",
        help="where races, result.json and tournament.png are kept (default: %(default)s)",
    )
    choice.add_argument("--resume", metavar="FOLDER", help="go on with the tournament in FOLDER")
    parser.add_argument("--json", action="store_true", help="write only JSON to stdout")
    parser.add_argument("--no-plot", action="store_true", help="draw no tournament.png")
    parser.add_argument(
        "--race-timeout",
        type=float,
        default=3600.0,
        metavar="SECONDS",
        help="for one race (default: %(default)s)",
    )
    add_flags(parser.add_argument_group("each race"), RaceSettings, leave_out=_LEFT_OUT)
    parser.set_defaults(run=_run, fail=parser.error)


def _run(arguments: argparse.Namespace) -> int:
    from stkzoo.errors import ConfigError
    from stkzoo.evaluation import BatchError

    folder = Path(arguments.resume or arguments.output)
    code = 0
    with BatchBar() as bar:
        try:
            result = _result(arguments, folder, bar)
        except ConfigError as error:
            bar.stop()
            arguments.fail(str(error))
        except BatchError as error:
            print(f"stkzoo: {error}", file=sys.stderr)
            result, code = error.result, 1
        except KeyboardInterrupt:
            print(
                f"stkzoo: interrupted after {bar.done} of {bar.total} races, which are kept; go "
                f"on with: stkzoo tournament --resume {folder}",
                file=sys.stderr,
            )
            return _INTERRUPTED
    if arguments.json:
        print(result.to_json())
    else:
        _show(result, folder)
    has_failed = any(row.errors for row in result.standings)
    return code or (_AGENT_FAILED if has_failed else 0)


def _result(arguments: argparse.Namespace, folder: Path, bar: BatchBar) -> TournamentResult:
    from stkzoo.errors import ConfigError
    from stkzoo.evaluation import resume_tournament, run_tournament
    from stkzoo.race import RaceSettings

    how: dict[str, Any] = {
        "jobs": arguments.jobs,
        "plot": not arguments.no_plot,
        "race_timeout": arguments.race_timeout,
        "on_race": bar.tell,
    }
    if arguments.resume:
        if arguments.agents:
            raise ConfigError("--resume knows its agents; leave them out")
        return resume_tournament(folder, **how)
    return run_tournament(
        arguments.agents,
        output=folder,
        tracks=arguments.tracks,
        races=arguments.races,
        per_race=arguments.per_race,
        seed=arguments.seed,
        settings=RaceSettings(**flags_given(arguments, RaceSettings, leave_out=_LEFT_OUT)),
        **how,
    )


def _kept(folder: Path) -> list[str]:
    return [name for name in ("result.json", "tournament.png", "races") if (folder / name).exists()]


def _show(result: TournamentResult, folder: Path) -> None:
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console()
    is_plain = not console.is_terminal
    table = Table(box=None if is_plain else box.ROUNDED, pad_edge=not is_plain)
    columns = ("place", "agent", "rating", "95 %", "races", "wins", "rank", "finished", "failed")
    for name in columns:
        table.add_column(name, justify="left" if name == "agent" else "right")
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
    for line in (
        f"{len(result.races)} of {plan.races} races of {plan.per_race} on "
        f"{', '.join(plan.tracks)}; Plackett-Luce ratings, intervals by bootstrap over races.",
        f"More in {folder}{os.sep}: {', '.join(_kept(folder))}",
    ):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
