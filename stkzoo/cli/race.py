"""``stkzoo race``: run a race and show who won."""

from __future__ import annotations

import argparse
import random
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from stkzoo.errors import ConfigError

if TYPE_CHECKING:
    from rich.table import Table

    from stkzoo.race import RaceProgress, RaceResult

__all__ = ["add_parser"]

_ABOUT = """\
Runs one race and shows how it ended. Each driver named gets a kart:

  ai          the game's own AI, as good as --difficulty says
  heuristic   a driver made of rules, which comes with stkzoo
  random      presses buttons at random

A package in the folder agents/ is a driver of its name. All karts are agents of one
PettingZoo ParallelEnv. The same seed gives the same race, bit for bit.
"""

_EXAMPLES = """\
examples:
  stkzoo race --demo                           the heuristic against three bots
  stkzoo race heuristic ai ai --track hacienda --laps 3
  stkzoo race heuristic --num-karts 8          seven bots beside it
  stkzoo race ai ai --track test --seed 7      one of the test tracks, drawn by the seed
  stkzoo race heuristic random --json -        the result as JSON
"""

_NEXT_STEPS = """\
Where to go next:
  your own driver     copy agents/heuristic, then: stkzoo race NAME ai ai ai
  from Python         from stkzoo import race_v0; env = race_v0.parallel_env(num_kart=4)
  more                README.md, stkzoo race --help, and stkzoo doctor if something fails
"""

_DEMO_DRIVERS = ("heuristic", "ai", "ai", "ai")
_DEMO_TRACK = "lighthouse"
_DEMO_SEED = 42


def add_parser(subparsers: argparse._SubParsersAction[Any]) -> None:
    """Adds the command."""
    parser = subparsers.add_parser(
        "race",
        help="run a race and show who won",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("drivers", nargs="*", metavar="DRIVER", help="who drives; see above")
    parser.add_argument(
        "--demo", action="store_true", help=f"four karts on {_DEMO_TRACK}: see who wins"
    )
    parser.add_argument(
        "--track", help="a track's name, or train, test or all to draw one (default: all)"
    )
    parser.add_argument("--laps", type=int, default=1, help="(default: %(default)s)")
    parser.add_argument("--seed", type=int, help="decides all that is left to chance")
    parser.add_argument(
        "--difficulty", type=int, default=2, help="of the AI, 0 to 3 (default: %(default)s)"
    )
    parser.add_argument("--reverse", action="store_true", help="drive the other way round")
    parser.add_argument(
        "--num-karts", type=int, metavar="N", help="fill the race up with the AI to N karts"
    )
    parser.add_argument(
        "--json", metavar="FILE", help="write the result into FILE; - writes only it, to stdout"
    )
    parser.set_defaults(run=_run, fail=parser.error)


def _run(arguments: argparse.Namespace) -> int:
    try:
        drivers, settings = _plan(arguments)
        result = _race(drivers, settings)
    except ConfigError as error:
        arguments.fail(str(error))
    if arguments.json == "-":
        print(result.to_json())
        return 0
    _show(result, with_next_steps=arguments.demo or sys.stdout.isatty())
    return _write(result, arguments.json) if arguments.json else 0


def _plan(arguments: argparse.Namespace) -> tuple[list[str], dict[str, Any]]:
    """Who drives, and the keywords of :func:`stkzoo.race.run_race`."""
    if arguments.demo and arguments.drivers:
        raise ConfigError("--demo brings its own drivers; leave out --demo or the drivers")
    drivers = list(_DEMO_DRIVERS if arguments.demo else arguments.drivers)
    if not drivers:
        raise ConfigError("nobody drives; name drivers, such as heuristic ai, or try --demo")
    num_karts = len(drivers) if arguments.num_karts is None else arguments.num_karts
    if num_karts < len(drivers):
        raise ConfigError(f"--num-karts is {num_karts}, but {len(drivers)} drivers are named")
    drivers += ["ai"] * (num_karts - len(drivers))
    seed = arguments.seed
    if seed is None:
        seed = _DEMO_SEED if arguments.demo else random.randrange(2**16)
    settings = {
        "track": arguments.track or (_DEMO_TRACK if arguments.demo else None),
        "laps": arguments.laps,
        "difficulty": arguments.difficulty,
        "reverse": arguments.reverse,
        "seed": seed,
    }
    return drivers, settings


def _race(drivers: list[str], settings: dict[str, Any]) -> RaceResult:
    from stkzoo.race import run_race

    with _ProgressBar() as bar:
        return run_race(drivers, listener=bar.show, **settings)


def _show(result: RaceResult, with_next_steps: bool) -> None:
    from rich.console import Console

    console = Console()
    console.print(_headline(result), soft_wrap=True, highlight=False)
    console.print(_table(result, is_plain=not console.is_terminal))
    race_time = result.agents[-1].finish_time
    ending = f"in {race_time:.1f} s of race time" if race_time else "by the runner's time limit"
    console.print(
        f"Over after {result.steps} steps, {ending}; it took {result.wall_time:.1f} s.",
        soft_wrap=True,
        highlight=False,
    )
    if with_next_steps:
        console.print(f"\n{_NEXT_STEPS}", end="", soft_wrap=True, highlight=False, markup=False)


def _headline(result: RaceResult) -> str:
    laps = "1 lap" if result.laps == 1 else f"{result.laps} laps"
    way = ", reversed" if result.reverse else ""
    return (
        f"{result.track}{way}: {laps}, {result.race_length:.0f} m, "
        f"AI difficulty {result.difficulty}, seed {result.seed}"
    )


def _table(result: RaceResult, is_plain: bool) -> Table:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None if is_plain else box.ROUNDED, pad_edge=not is_plain)
    for name in ("rank", "driver", "kart", "time [s]", "distance [m]", "reward"):
        is_text = name in ("driver", "kart")
        table.add_column(escape(name), justify="left" if is_text else "right")
    for row in result.agents:
        time_text = "not finished" if row.finish_time is None else f"{row.finish_time:.2f}"
        table.add_row(
            str(row.rank),
            row.driver,
            row.agent,
            time_text,
            f"{row.distance:.0f}",
            f"{row.reward:.1f}",
            style="bold green" if row.rank == 1 else None,
        )
    return table


def _write(result: RaceResult, file: str) -> int:
    try:
        Path(file).write_text(result.to_json() + "\n", encoding="utf-8")
    except OSError as error:
        print(f"stkzoo: the result could not be written: {error}", file=sys.stderr)
        return 1
    return 0


class _ProgressBar:
    """The leader's way and the simulation's speed, on a terminal's stderr."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        console = Console(stderr=True)
        self._bars = Progress(
            TextColumn("{task.description:<19}"),
            BarColumn(),
            TextColumn("{task.fields[way]}"),
            console=console,
            transient=True,
            disable=not (console.is_terminal and sys.stdout.isatty()),
        )
        self._task = self._bars.add_task("starting the game", total=1.0, way="")
        self._begin = time.monotonic()

    def __enter__(self) -> _ProgressBar:
        self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bars.stop()

    def show(self, progress: RaceProgress) -> None:
        """Takes what the runner tells."""
        if progress.steps == 0:
            self._begin = time.monotonic()
        elapsed = max(time.monotonic() - self._begin, 1e-3)
        leader = progress.leader_distance
        is_won = leader >= progress.race_length
        self._bars.update(
            self._task,
            description="the others come in" if is_won else "the leader",
            total=progress.race_length,
            completed=leader,
            way=f"{leader:4.0f} of {progress.race_length:.0f} m, "
            f"{progress.race_time / elapsed:3.0f} x real time",
        )
