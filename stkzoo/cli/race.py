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

import contextlib
import json
import os
import random
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from stkzoo._arguments import option, options_of, positional, refuse_options
from stkzoo._checks import check_whole
from stkzoo._os import check_writable, write_whole
from stkzoo.cli._process import AGENT_FAILED, INTERRUPTED
from stkzoo.cli._race_options import ViewingArguments, replay_listeners, replay_option
from stkzoo.cli._race_report import RaceBar, show_race, show_series
from stkzoo.drivers.failures import in_words
from stkzoo.errors import AgentError, ConfigError, StkzooError
from stkzoo.race import Driver, RaceListener, RaceProgress, RaceResult, RaceSettings, run_race
from stkzoo.race.listeners import ExpendableListener

_DEMO_DRIVERS = ("pretrained:zenith", "ai:3", "ai:3", "ai:3")
_DEMO_TRACK, _DEMO_SEED = "lighthouse", 17


@dataclass
class RacesArguments:
    """Options of commands that run races of named drivers.

    Attributes:
        drivers: the drivers; see above
        num_karts: add karts of the game's AI until there are N karts
        races: number of races; their seeds are consecutive
        seed: seed of all random choices (default: a new one each time)
        output: write the result to FILE as JSON
        json: write only JSON to stdout
    """

    drivers: tuple[str, ...] = positional((), metavar="DRIVER")
    settings: dict[str, Any] = options_of(RaceSettings, without=("seed",), group="race")
    num_karts: int | None = option(group="race")
    races: int = option(1, group="race")
    seed: int | None = option(group="race")
    output: str | None = option(metavar="FILE", group="output")
    json: bool = option(False, group="output")
    replay: str | None = replay_option()
    viewing: ViewingArguments = options_of(ViewingArguments)

    def outputs(self) -> list[RaceListener]:
        """Returns the listeners that write or show a race."""
        return [*replay_listeners(self.replay), *self.viewing.listeners()]


@dataclass
class RaceArguments(RacesArguments):
    """Options of ``stkzoo race``.

    Attributes:
        demo: a demonstration: a learned driver against three karts of the AI
    """

    demo: bool = False


def run(arguments: RaceArguments, **outputs: Any) -> int:
    """Runs races of the named drivers.

    Args:
        arguments: the options.
        **outputs: as for :func:`run_races`.
    """
    if not arguments.demo:
        return run_races(arguments, arguments.drivers, **outputs)
    if arguments.drivers:
        raise ConfigError("--demo brings its own drivers; leave out --demo or the drivers")
    arguments.settings["track"] = arguments.settings["track"] or _DEMO_TRACK
    arguments.seed = _DEMO_SEED if arguments.seed is None else arguments.seed
    code = run_races(arguments, _DEMO_DRIVERS, **outputs)
    if code == 0 and not arguments.json:
        print("\nNext: `stkzoo new my_agent` creates an agent of your own; see `stkzoo --help`.")
    return code


def run_races(
    arguments: RacesArguments,
    drivers: Sequence[str | Driver],
    *,
    document: Callable[[Sequence[RaceResult], AgentError | None], str] | None = None,
    listeners: Sequence[RaceListener] = (),
) -> int:
    """Runs the races that options describe.

    Args:
        arguments: the options.
        drivers: the drivers.
        document: returns the JSON for ``--output`` and ``--json`` of the results and the error that
            ended the last race; empty for none.
        listeners: further listeners of the races.

    Returns:
        The exit code.
    """
    results: list[RaceResult] = []
    problems: list[Exception] = []
    failure: AgentError | None = None
    code = 0
    try:
        with _prints_on_stderr() if arguments.json else contextlib.nullcontext():
            drivers, seed = _plan(arguments, drivers)
            for number in range(arguments.races):
                settings = {**arguments.settings, "seed": seed + number}
                with RaceBar() as bar:
                    outputs = [ExpendableListener(o) for o in (bar, *arguments.outputs())]
                    watches = (_ResultKeeper(results), *outputs, *listeners)
                    run_race(drivers, listeners=watches, **settings)
                problems += [output.error for output in outputs if output.error is not None]
    except AgentError as error:
        print(f"stkzoo: {error}\n{error.trace}".rstrip(), file=sys.stderr)
        code, failure = AGENT_FAILED, error
    except KeyboardInterrupt:
        if not results:
            raise
        is_partial = results[-1].status == "interrupted"
        rest = "the last race is incomplete" if is_partial else f"complete races: {len(results)}"
        print(f"stkzoo: interrupted; {rest}", file=sys.stderr)
        code = INTERRUPTED
    except StkzooError as error:
        if not results:
            raise
        problems.append(error)
    for problem in problems:
        print(f"stkzoo: {in_words(problem)}", file=sys.stderr)
    text = document(results, failure) if document else _document(results, arguments.races)
    _report(results, text, arguments)
    has_failed = any(result.has_errors for result in results)
    return code or (1 if problems else AGENT_FAILED if has_failed else 0)


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
    arguments: RacesArguments, drivers: Sequence[str | Driver]
) -> tuple[list[str | Driver], int]:
    """Returns the drivers of all karts, and the seed of the first race.

    Raises:
        ConfigError: the options are invalid.
    """
    if arguments.output is not None:
        check_writable(arguments.output, "the result")
    viewing = arguments.viewing
    outputs = [arguments.output, arguments.replay, viewing.video.video]
    for file in filter(None, outputs):
        if outputs.count(file) > 1:
            raise ConfigError(f"{file!r} is named for two outputs; give each a file of its own")
    check_whole("--races", arguments.races, 1)
    if arguments.races > 1:
        for_one = {
            "--replay": arguments.replay is not None,
            "--video": viewing.video.video is not None,
            "--web-stay": viewing.page.web_stay,
        }
        refuse_options("--races runs several races", [name for name in for_one if for_one[name]])
    if not drivers:
        raise ConfigError("no drivers; name some, such as heuristic ai, or try --demo")
    num_karts = len(drivers) if arguments.num_karts is None else arguments.num_karts
    if num_karts < len(drivers):
        raise ConfigError(f"--num-karts is {num_karts}, but {len(drivers)} drivers are named")
    seed = random.randrange(2**16) if arguments.seed is None else arguments.seed
    return [*drivers, *["ai"] * (num_karts - len(drivers))], seed


class _ResultKeeper(RaceListener):
    """Stores the results of races, and ends a race that begins without one of its agents.

    Args:
        results: list to which the results are appended.
    """

    def __init__(self, results: list[RaceResult]) -> None:
        self._results = results

    def started(self, race: RaceProgress) -> None:
        """Checks the agents.

        Raises:
            AgentError: agents could not be loaded; the error describes all of them.
        """
        failed = [(agent, errors[0]) for agent, errors in race.failures.items() if errors]
        if failed:
            texts = [f"{race.names[a]} ({a}) could not be loaded: {e.message}" for a, e in failed]
            traces = [error.trace for _, error in failed]
            for text, trace in zip(texts[1:], traces[1:], strict=True):
                traces[0] += f"\n\n{text}\n{trace}"
            raise AgentError(texts[0], failed[0][0], traces[0])

    def ended(self, result: RaceResult) -> None:
        """Stores the result, also if another listener fails or is interrupted after the race."""
        self._results.append(result)


def _report(results: Sequence[RaceResult], text: str, arguments: RacesArguments) -> None:
    """Writes and shows the results, even if they cannot be written.

    Args:
        results: results of the races.
        text: the same as JSON; empty for none.
        arguments: the options.
    """
    try:
        if arguments.output and text:
            with write_whole(arguments.output, "the result", StkzooError) as part:
                part.write_text(text + "\n", encoding="utf-8")
    finally:
        if arguments.json:
            print(text, end="\n" if text else "")
        elif arguments.races > 1 and results:
            show_series(results)
        elif results:
            show_race(results[0])


def _document(results: Sequence[RaceResult], races: int) -> str:
    """Returns the JSON for ``--output`` and ``--json``; empty if no race ended."""
    if not results:
        return ""
    if races == 1:
        return results[0].to_json()
    series = [json.loads(result.to_json()) for result in results]
    values = {"type": "race-series", "schema_version": RaceResult.version, "races": series}
    return json.dumps(values, indent=2)
