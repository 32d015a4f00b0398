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

import shutil
import sys
from collections import defaultdict
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from stkzoo._arguments import changed_options, option, options_of, positional, refuse_options
from stkzoo._locks import locked_folder
from stkzoo._os import make_folder, write_whole
from stkzoo._schema import plain_text
from stkzoo.cli._batch import RUN_OPTIONS, file_name, run_and_show, tracks_option
from stkzoo.cli._console import say, show_table
from stkzoo.cli.race_client import ServersArguments, server_access
from stkzoo.drivers.files import AgentFiles, is_zip
from stkzoo.errors import ConfigError
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


# ------------------------------------------------------------------ hand-ins of a course


def collect_agents(hand_ins: Path | None, limit: str | None, folder: Path) -> tuple[str, ...]:
    """Copies the newest valid hand-in of each participant, and returns the paths of the copies.

    A copy that exists stays, so the tournament can resume after newer hand-ins. Prints on stderr
    which zips are late or invalid, or newer than the copy.

    Args:
        hand_ins: folder with a zip, or a folder of zips, for each participant; ``None`` for none.
        limit: the deadline, in ISO format; ``None`` for none.
        folder: folder of the tournament.

    Raises:
        ConfigError: the deadline is invalid or in the future, or a folder cannot be used.
    """
    if hand_ins is None and limit is None:
        return ()
    if hand_ins is None or not hand_ins.is_dir():
        raise ConfigError(f"--hand-ins is {hand_ins}, expected the folder of the hand-ins")
    deadline = None if limit is None else _past_time(limit)
    zips: dict[str, list[Path]] = defaultdict(list)
    for entry in sorted(hand_ins.glob("[!.]*")):
        is_folder = entry.is_dir() and not entry.is_symlink()
        name = entry.name if is_folder else entry.stem
        zips[file_name(name)] += entry.glob("[!.]*") if is_folder else [entry]
    copies = folder / "hand-ins"
    with locked_folder(folder, "tournament"):
        make_folder(copies, "tournament")
        for name, files in zips.items():
            _copy_newest(files, copies / f"{name}.zip", deadline)
    return tuple(map(str, sorted(copies.glob("*.zip"))))


def _copy_newest(files: Iterable[Path], copy: Path, deadline: datetime | None) -> None:
    """Copies the newest valid zip among files, unless there is a copy."""
    for file in sorted(files, key=_time_of, reverse=True):
        if copy.exists() and _time_of(file) <= _time_of(copy):
            return
        try:
            _check(file, copy, deadline)
        except ConfigError as error:
            print(f"stkzoo: left out: {plain_text(str(error))}", file=sys.stderr)
            continue
        with write_whole(copy, "the hand-in") as part:
            shutil.copyfile(file, part)
        return


def _check(file: Path, copy: Path, deadline: datetime | None) -> None:
    """Checks that a hand-in is a zip with an agent, in time, and the first for a copy.

    Raises:
        ConfigError: it is not.
    """
    if deadline is not None and _time_of(file) > deadline:
        raise ConfigError(f"{file} is late: it was changed at {_time_of(file):%Y-%m-%d %H:%M:%S}")
    if copy.exists():
        raise ConfigError(f"{file} is newer than {copy}; for another round, choose a new --output")
    if not is_zip(file) or file.is_symlink() or not file.is_file():
        raise ConfigError(f"{file} is not a zip")
    with ExitStack() as resources:
        AgentFiles(str(file), file).place(resources)


def _time_of(file: Path) -> datetime:
    return datetime.fromtimestamp(file.lstat().st_mtime).astimezone()


def _past_time(text: str) -> datetime:
    """Returns the time of a deadline.

    Raises:
        ConfigError: the text is not a date with a time of day, or the time is in the future.
    """
    try:
        deadline = datetime.fromisoformat(text).astimezone()
    except (ValueError, OverflowError):
        deadline = None
    if deadline is None or ":" not in text:
        raise ConfigError(
            f"--deadline is {text!r}, expected a time such as 2026-12-01T18:00, in the time zone "
            "of this machine, or with one, such as 2026-12-01T18:00+01:00"
        )
    if deadline > datetime.now().astimezone():
        raise ConfigError(
            f"--deadline {text} is in the future; run the tournament afterwards, or leave it out"
        )
    return deadline
