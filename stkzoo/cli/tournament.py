"""Rate agents in many races.

Runs many races among agents and rates the agents. The schedule is balanced: all agents race about
equally often, on each track, from each place of the grid, and against each other agent.

Each race is stored in the output folder as soon as it ends. After an interruption, the same
command or --resume FOLDER resumes. Additional agents join the tournament and get additional
races. An agent that fails loses its race, and the tournament continues.

Choose --races as agents * 15 / --per-race, so that each agent has 15 races. A race of five agents
from files on a short track takes about 15 s; --jobs races run at the same time.

Name agents as for `stkzoo race`: ai, heuristic, random, a folder, a zip or a module; append
@:Name to rename one. --hand-ins takes the zips of a course: FOLDER has a zip for each participant,
or a folder with all of the participant's zips. The newest valid zip races.

Examples:
  stkzoo tournament heuristic ai random my_agent/ --track lighthouse hacienda
  stkzoo tournament students/*.zip ai --races 300 --per-race 5 --output league
  stkzoo tournament --resume league
  stkzoo tournament --resume league late.zip       late.zip joins
  stkzoo tournament ai --servers servers.txt --secret course.secret
  stkzoo tournament ai --hand-ins submissions --deadline 2026-12-01T18:00

exit codes:
  0 success, 1 a race could not be run, 2 invalid command line, 3 an agent
  failed in some race, 130 interrupted
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stkzoo._arguments import changed_options, option, options_of, positional, refuse_options
from stkzoo.cli._batch import RUN_OPTIONS, run_and_show, tracks_option
from stkzoo.cli._console import say, show_table
from stkzoo.cli._hand_ins import collect_agents
from stkzoo.cli.race_client import ServersArguments, server_access
from stkzoo.evaluation import RunOptions, TournamentPlan, TournamentResult, plan_tournament
from stkzoo.evaluation.tournament.plan import resumed_plan
from stkzoo.evaluation.tournament.run import TOURNAMENT
from stkzoo.race import RaceSettings

_COLUMNS = ("place", "agent", "rating", "95%", "group")
_COUNTS = ("races", "wins", "rank", "finished", "failed")


@dataclass
class ScheduleArguments:
    """Options of the races of a tournament.

    Attributes:
        races: number of races
        per_race: number of agents in a race (default: 4, or all if there are fewer)
        seed: seed of the schedule and the races
    """

    tracks: tuple[str, ...] = tracks_option()
    races: int = 60
    per_race: int | None = None
    seed: int = 0


@dataclass
class TournamentArguments:
    """Options of ``stkzoo tournament``.

    Attributes:
        agents: the agents; see above
        hand_ins: folder with a zip, or a folder of zips, for each participant; they are copied
        deadline: leave out zips that were changed after TIME, such as 2026-12-01T18:00
        output: folder for the races, result.json and report.html
        resume: resume the tournament in FOLDER; agents that you name join it
        json: write only JSON to stdout
    """

    agents: tuple[str, ...] = positional((), metavar="AGENT")
    hand_ins: Path | None = option(metavar="FOLDER", group="course")
    deadline: str | None = option(metavar="TIME", group="course")
    schedule: ScheduleArguments = options_of(ScheduleArguments)
    output: str = option("tournament", metavar="FOLDER", rivals="folder", group="output")
    resume: str | None = option(metavar="FOLDER", rivals="folder", group="output")
    json: bool = option(False, group="output")
    servers: ServersArguments = options_of(ServersArguments, group="agents of servers")
    batch: dict[str, Any] = options_of(RunOptions, only=RUN_OPTIONS)
    settings: dict[str, Any] = options_of(
        RaceSettings, without=TournamentPlan.decided, group="each race"
    )


def run(arguments: TournamentArguments) -> int:
    """Runs or resumes a tournament."""
    folder = Path(arguments.resume or arguments.output)
    arguments.agents += collect_agents(arguments.hand_ins, arguments.deadline, folder)
    return run_and_show(arguments, TOURNAMENT, _plan(arguments), folder, _show)


def _plan(arguments: TournamentArguments) -> TournamentPlan:
    agents, servers = arguments.agents, server_access(arguments.servers)
    if arguments.resume is None:
        schedule = vars(arguments.schedule)
        return plan_tournament(agents, servers=servers, **schedule, **arguments.settings)
    show_output = arguments.settings.pop("show_output")
    changed = changed_options(arguments, only=("schedule", "settings"))
    refuse_options("--resume keeps the arguments of its tournament", changed)
    plan = resumed_plan(Path(arguments.resume), agents, servers)
    return replace(plan, settings=replace(plan.settings, show_output=show_output))


def _show(result: TournamentResult) -> None:
    rows = []
    for row, group in zip(result.standings, result.groups, strict=True):
        interval = f"{row.rating.low:.1f} to {row.rating.high:.1f}"
        counts = (group, row.races, row.wins, row.mean_rank, row.finished, row.failed)
        rows.append((row.place, row.label, row.rating.value, interval, *counts))
    styles = ["red" if row.errors else None for row in result.standings]
    show_table((*_COLUMNS, *_COUNTS), rows, styles=styles)
    for row in result.standings:
        if row.reason:
            say(f"{row.label} failed in {row.failed} of {row.races} races: {row.reason}")
    plan = result.plan
    say(
        f"{len(result.races)} of {plan.num_races} races of {plan.grid_size} on "
        f"{', '.join(plan.tracks)}; Plackett-Luce ratings, intervals by bootstrap over races."
    )
