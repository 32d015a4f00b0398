"""Run a race and show who won.

Each driver gets a kart:

  ai                 the game's AI; ai:3 sets --difficulty to 3
  heuristic          a rule-based driver that comes with stkzoo
  pretrained:zenith  a learned driver, the best that comes with stkzoo
  random             random actions
  FOLDER, ZIP        your agent: a pystk_actor.py with get_actor(...)
  MODULE             your agent, by the name of a Python module

DRIVER@:Name sets a driver's name. Each agent from files runs in its own process, so a failure
only affects its own kart. The same seed reproduces the same race, bit for bit.

Examples:
  stkzoo race --demo                          a learned driver against the AI
  stkzoo race heuristic ai ai --track hacienda --laps 3
  stkzoo race my_agent/ other.zip@:Rival ai   your agents against the game's AI
  stkzoo race my_agent/ ai --races 10 --track test --output results.json
  stkzoo race heuristic --num-karts 8         against seven of the game's AI
  stkzoo race heuristic random --json         the result as JSON
  stkzoo race my_agent/ ai --show-output      see what your agent prints

exit codes:
  0 success, 1 the race could not be run, 2 invalid command line, 3 an agent
  failed (the result has the error; an agent that cannot be loaded ends the
  command before the race), 130 interrupted
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from stkzoo._arguments import CommandParser, add_options, option, positional, values_of
from stkzoo._os import check_writable, write_whole
from stkzoo.cli import _race_options
from stkzoo.cli._arguments import AGENT_FAILED, INTERRUPTED, usage_errors
from stkzoo.cli._process import writing_stdout
from stkzoo.drivers.failures import in_words
from stkzoo.errors import AgentError, ConfigError, StkzooError
from stkzoo.race import RaceSettings

if TYPE_CHECKING:
    from stkzoo.race import Driver, RaceResult

_NEXT_STEPS = """\
Where to go next:
  another race      stkzoo race pretrained:zenith ai:3 ai:3 ai:3 --seed 2
  your own driver   stkzoo new my_agent
  from Python       from stkzoo import race_v0
                    env = race_v0.parallel_env(num_kart=4)
  more              stkzoo race --help; stkzoo doctor if something fails
"""

_DEMO_DRIVERS = ("pretrained:zenith", "ai:3", "ai:3", "ai:3")
_DEMO_TRACK = "lighthouse"
_DEMO_SEED = 17
_DECIDED = ("seed",)


@dataclass
class RacesArguments:
    """Options of commands that run races of named drivers.

    Attributes:
        num_karts: add karts of the game's AI until there are N karts
        races: number of races; their seeds are consecutive
        seed: seed of all random choices (default: a new one each time)
        output: write the result to FILE as JSON
        json: write only JSON to stdout
    """

    num_karts: int | None = option(group="race")
    races: int = option(1, group="race")
    seed: int | None = option(group="race")
    output: str | None = option(metavar="FILE", group="output")
    json: bool = option(False, group="output")


@dataclass
class RaceArguments:
    """Options of ``stkzoo race`` alone.

    Attributes:
        drivers: the drivers; see above
        demo: a demonstration: a learned driver against three karts of the AI
    """

    drivers: tuple[str, ...] = positional((), metavar="DRIVER")
    demo: bool = False


def add_arguments(parser: CommandParser) -> None:
    """Declares the arguments."""
    add_options(parser, RaceArguments)
    add_race_options(parser)


def add_race_options(parser: CommandParser) -> None:
    """Adds all options of a race except its drivers."""
    add_options(parser, RaceSettings, without=_DECIDED, group="race")
    add_options(parser, RacesArguments)
    _race_options.add_replay_options(parser)
    _race_options.add_viewing_options(parser)
    parser.set_defaults(document=_document, listeners=())


@usage_errors
def run(arguments: argparse.Namespace) -> int:
    """Runs races of the named drivers."""
    return run_races(arguments)


def run_races(arguments: argparse.Namespace, remote: Sequence[Driver] = ()) -> int:
    """Runs the races that the options of :func:`add_race_options` describe.

    Args:
        arguments: these options, ``drivers`` and ``demo``.
        remote: additional drivers, which get the first karts.

    Returns:
        The exit code.
    """
    from stkzoo.race import RaceInterrupted

    results: list[RaceResult] = []
    problems: list[Exception] = []
    failure: AgentError | None = None
    code = 0
    try:
        with _prints_on_stderr() if arguments.json else contextlib.nullcontext():
            for drivers, settings in _plan(arguments, remote):
                results.append(_race(drivers, settings, arguments, problems))
    except AgentError as error:
        print(f"stkzoo: {error}\n{error.trace}".rstrip(), file=sys.stderr)
        code, failure = AGENT_FAILED, error
    except RaceInterrupted as interrupt:
        results.append(interrupt.result)
        print("stkzoo: interrupted; the last race is incomplete", file=sys.stderr)
        code = INTERRUPTED
    except KeyboardInterrupt:  # between two races, or before the first step of one
        if not results:
            raise
        print(f"stkzoo: interrupted; complete races: {len(results)}", file=sys.stderr)
        code = INTERRUPTED
    except StkzooError as error:
        if not results:
            raise
        problems.append(error)
    reported = _report(results, failure, arguments, problems)
    for problem in problems:
        print(f"stkzoo: {in_words(problem)}", file=sys.stderr)
    return code or (1 if problems else reported)


@contextlib.contextmanager
def _prints_on_stderr() -> Iterator[None]:
    """Redirects stdout to stderr, so that output of agents does not mix with the JSON on stdout."""
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def _plan(
    arguments: argparse.Namespace, remote: Sequence[Driver]
) -> list[tuple[list[str | Driver], dict[str, Any]]]:
    """Returns the drivers and the settings of :func:`stkzoo.race.run_race` for each race.

    Raises:
        ConfigError: the options are invalid.
    """
    if arguments.demo and arguments.drivers:
        raise ConfigError("--demo brings its own drivers; leave out --demo or the drivers")
    if arguments.output is not None:
        check_writable(arguments.output, "the result")
    outputs = [arguments.output, arguments.replay, arguments.video]
    for file in filter(None, outputs):
        if outputs.count(file) > 1:
            raise ConfigError(f"{file!r} is named for two outputs; give each a file of its own")
    if arguments.races < 1:
        raise ConfigError(f"--races is {arguments.races}, expected 1 or more")
    drivers = [*remote, *(_DEMO_DRIVERS if arguments.demo else arguments.drivers)]
    if not drivers:
        raise ConfigError("no drivers; name some, such as heuristic ai, or try --demo")
    num_karts = len(drivers) if arguments.num_karts is None else arguments.num_karts
    if num_karts < len(drivers):
        raise ConfigError(f"--num-karts is {num_karts}, but {len(drivers)} drivers are named")
    drivers += ["ai"] * (num_karts - len(drivers))
    settings, seed = values_of(arguments, RaceSettings, without=_DECIDED), arguments.seed
    if seed is None:
        seed = _DEMO_SEED if arguments.demo else random.randrange(2**16)
    if arguments.demo:
        settings["track"] = settings["track"] or _DEMO_TRACK
    return [(drivers, {**settings, "seed": seed + number}) for number in range(arguments.races)]


def _race(
    drivers: list[str | Driver],
    settings: dict[str, Any],
    arguments: argparse.Namespace,
    problems: list[Exception],
) -> RaceResult:
    """Runs one race.

    Args:
        drivers: the drivers.
        settings: settings of the race.
        arguments: the options, which name the outputs.
        problems: list to which errors are appended that only affect an output, not the result.
    """
    from stkzoo.cli._race_report import LoadCheck, RaceBar
    from stkzoo.race import RaceInterrupted, run_race
    from stkzoo.race.listeners import ExpendableListener, ResultKeeper

    with RaceBar() as bar:
        replay = _race_options.replay_listeners(arguments)
        shown = _race_options.viewing_listeners(arguments)
        outputs = [ExpendableListener(listener) for listener in (bar, *replay, *shown)]
        keeper = ResultKeeper()
        listeners = [keeper, LoadCheck(), *outputs, *arguments.listeners]
        try:
            run_race(drivers, listeners=listeners, **settings)
        except KeyboardInterrupt as interrupt:
            if keeper.result is None:
                raise
            raise RaceInterrupted(keeper.result) from interrupt
        except Exception as error:
            if keeper.result is None:
                raise
            problems.append(error)
    problems += [output.error for output in outputs if output.error is not None]
    assert keeper.result is not None  # noqa: S101 - the race has ended
    return keeper.result


def _report(
    results: Sequence[RaceResult],
    failure: AgentError | None,
    arguments: argparse.Namespace,
    problems: list[Exception],
) -> int:
    """Writes and shows the results, even if one of the two fails.

    Args:
        results: results of the races.
        failure: error that ended the last race.
        arguments: the options.
        problems: list to which errors are appended.

    Returns:
        The exit code: 3 if an agent failed, otherwise 0.
    """
    code = AGENT_FAILED if any(result.has_errors for result in results) else 0
    text = arguments.document(results, failure, arguments)
    try:
        if arguments.output and text:
            with write_whole(arguments.output, "the result", StkzooError) as part:
                part.write_text(text + "\n", encoding="utf-8")
    except StkzooError as error:
        problems.append(error)
    try:
        with writing_stdout():
            if arguments.json:
                print(text, end="\n" if text else "")
            elif results:
                _show(results, arguments)
    except StkzooError as error:
        problems.append(error)
    return code


def _show(results: Sequence[RaceResult], arguments: argparse.Namespace) -> None:
    from stkzoo.cli._race_report import show_race, show_series

    if arguments.races > 1:
        show_series(results)
    else:
        show_race(results[0])
    if arguments.demo:
        print(f"\n{_NEXT_STEPS}", end="")


def _document(
    results: Sequence[RaceResult], _: AgentError | None, arguments: argparse.Namespace
) -> str:
    """Returns the JSON for ``--output`` and ``--json``; empty if no race ended."""
    from stkzoo.race import SCHEMA_VERSION

    if not results:
        return ""
    if arguments.races == 1:
        return results[0].to_json()
    races = [json.loads(result.to_json()) for result in results]
    values = {"type": "race-series", "schema_version": SCHEMA_VERSION, "races": races}
    return json.dumps(values, indent=2)
