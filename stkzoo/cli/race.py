"""``stkzoo race``: run races and show who won."""

from __future__ import annotations

import argparse
import json
import random
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stkzoo._os import atomic_write
from stkzoo.cli.flags import add_flags, flags_given
from stkzoo.errors import AgentError, ConfigError

if TYPE_CHECKING:
    from stkzoo.race import Driver, RaceListener, RaceResult

__all__ = ["EXTRAS", "add_parser", "add_race_flags", "run_races"]

#: What can be attached to a race: modules of this package with ``add_flags(parser)`` and
#: ``listeners(arguments) -> list[RaceListener]``. Each is light to import.
EXTRAS: tuple[str, ...] = ("race_replay", "race_window", "race_video", "race_web")

_ABOUT = """\
Runs a race and shows how it ended. Each driver named gets a kart:

  ai               the game's own AI, as good as --difficulty says; ai:3 sets that too
  heuristic        a driver made of rules, which comes with stkzoo
  pretrained:ace   a learned one, the best that comes with stkzoo; docs/learning.md
  random           presses buttons at random
  FOLDER, ZIP      an agent of yours: a pystk_actor.py with get_actor(...); docs/agents.md
  MODULE           the same, by the name that Python imports it by

DRIVER@:Name says what to call it. Agents of files run each in a process of its own: what
goes wrong in one costs its own kart. The same seed gives the same race, bit for bit.
"""

_EXAMPLES = """\
examples:
  stkzoo race --demo                           the best driver here against the hardest bots
  stkzoo race heuristic ai ai --track hacienda --laps 3
  stkzoo race my_agent/ other.zip@:Rival ai    agents of files against the game's AI
  stkzoo race my_agent/ ai --races 10 --track test --output results.json
  stkzoo race heuristic --num-karts 8          seven bots beside it
  stkzoo race heuristic random --json -        the result as JSON

exit codes:
  0 all is well, 1 the race could not be run, 2 the command cannot be understood,
  3 an agent failed (what is known of it stands in the result), 130 interrupted
"""

_NEXT_STEPS = """\
Where to go next:
  another race        stkzoo race pretrained:ace ai:3 ai:3 ai:3 --seed 2 (it does not win all)
  your own driver     docs/agents.md; then: stkzoo race FOLDER ai ai ai
  from Python         from stkzoo import race_v0; env = race_v0.parallel_env(num_kart=4)
  more                README.md, stkzoo race --help, and stkzoo doctor if something fails
"""

_DEMO_DRIVERS = ("pretrained:ace", "ai:3", "ai:3", "ai:3")
_DEMO_TRACK = "lighthouse"
_DEMO_SEED = 1
_AGENT_FAILED = 3
_INTERRUPTED = 130


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
    add_race_flags(parser)
    parser.set_defaults(run=run_races, fail=parser.error)


def add_race_flags(parser: argparse.ArgumentParser) -> None:
    """Adds all that says how a race is run, whoever drives."""
    from stkzoo.race import RaceSettings

    parser.add_argument(
        "--num-karts", type=int, metavar="N", help="fill the race up with the AI to N karts"
    )
    parser.add_argument(
        "--races", type=int, default=1, metavar="N", help="so many races, with following seeds"
    )
    parser.add_argument(
        *("--output", "--json"),
        metavar="FILE",
        help="write the result into FILE as JSON; - writes only it, to stdout",
    )
    parser.add_argument("--seed", type=int, metavar="N", help="decides all that is left to chance")
    add_flags(parser.add_argument_group("the race"), RaceSettings, leave_out=("seed",))
    for name in EXTRAS:
        import_module(f"stkzoo.cli.{name}").add_flags(parser)


def run_races(arguments: argparse.Namespace, remote: Sequence[Driver] = ()) -> int:
    """Runs the races that the flags of :func:`add_race_flags` ask for.

    Args:
        arguments: the flags, and ``drivers``, ``demo`` and ``fail``.
        remote: drivers besides those named, who get the first karts.

    Returns:
        The exit code.
    """
    from stkzoo.race import RaceInterrupted

    results: list[RaceResult] = []
    code = 0
    try:
        for drivers, settings in _plan(arguments, remote):
            results.append(_race(drivers, settings, arguments))
    except ConfigError as error:
        arguments.fail(str(error))
    except AgentError as error:
        print(f"stkzoo: {error}\n{error.trace}".rstrip(), file=sys.stderr)
        code = _AGENT_FAILED
    except RaceInterrupted as interrupt:
        results.append(interrupt.result)
        print("stkzoo: interrupted; the last race is incomplete", file=sys.stderr)
        code = _INTERRUPTED
    reported = _report(results, arguments)
    return code or reported


def _plan(
    arguments: argparse.Namespace, remote: Sequence[Driver]
) -> list[tuple[list[str | Driver], dict[str, Any]]]:
    """For each race who drives, and the settings of :func:`stkzoo.race.run_race`."""
    from stkzoo.race import RaceSettings

    if arguments.demo and arguments.drivers:
        raise ConfigError("--demo brings its own drivers; leave out --demo or the drivers")
    if arguments.races < 1:
        raise ConfigError(f"--races is {arguments.races}, expected 1 or more")
    drivers = [*remote, *(_DEMO_DRIVERS if arguments.demo else arguments.drivers)]
    if not drivers:
        raise ConfigError("nobody drives; name drivers, such as heuristic ai, or try --demo")
    num_karts = len(drivers) if arguments.num_karts is None else arguments.num_karts
    if num_karts < len(drivers):
        raise ConfigError(f"--num-karts is {num_karts}, but {len(drivers)} drivers are named")
    drivers += ["ai"] * (num_karts - len(drivers))
    settings = flags_given(arguments, RaceSettings, leave_out=("seed",))
    seed = arguments.seed
    if seed is None:
        seed = _DEMO_SEED if arguments.demo else random.randrange(2**16)
    if arguments.demo:
        settings["track"] = settings["track"] or _DEMO_TRACK
    return [(drivers, {**settings, "seed": seed + number}) for number in range(arguments.races)]


def _race(
    drivers: list[str | Driver], settings: dict[str, Any], arguments: argparse.Namespace
) -> RaceResult:
    from stkzoo.cli.race_report import RaceBar
    from stkzoo.race import run_race

    with RaceBar() as bar:
        listeners: list[RaceListener] = [bar]
        for name in EXTRAS:
            listeners += import_module(f"stkzoo.cli.{name}").listeners(arguments)
        return run_race(drivers, listeners=listeners, **settings)


def _report(results: Sequence[RaceResult], arguments: argparse.Namespace) -> int:
    """Shows and writes the results."""
    from stkzoo.cli.race_report import show_race, show_series

    if not results:
        return 0
    code = _AGENT_FAILED if any(result.has_errors for result in results) else 0
    text = _as_json(results, is_series=arguments.races > 1)
    if arguments.output == "-":
        print(text)
        return code
    if arguments.races > 1:
        show_series(results)
    else:
        show_race(results[0])
    if arguments.demo or (sys.stdout.isatty() and not code):
        print(f"\n{_NEXT_STEPS}", end="")
    if arguments.output:
        return _write(text, Path(arguments.output)) or code
    return code


def _as_json(results: Sequence[RaceResult], *, is_series: bool) -> str:
    from stkzoo.race import SCHEMA_VERSION

    if not is_series:
        return results[0].to_json()
    races = [json.loads(result.to_json()) for result in results]
    form = {"type": "race-series", "schema_version": SCHEMA_VERSION, "races": races}
    return json.dumps(form, indent=2)


def _write(text: str, file: Path) -> int:
    """Writes the whole file or none."""
    try:
        with atomic_write(file) as part:
            part.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        print(f"stkzoo: the result could not be written: {error}", file=sys.stderr)
        return 1
    return 0
