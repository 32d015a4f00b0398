"""Run the commands of pystk2-gymnasium.

For scripts that call `pystk2`: takes the same commands, options and defaults, and writes results
in the same format. Races run as with `stkzoo race`, whose other options also work. A reward is the
sum over the race, and the exit code is 3 if an agent failed. A line on stderr reports other
differences.

Examples:
  stkzoo pystk2 race my_agent.zip --track lighthouse --hide --output result.json
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from stkzoo._arguments import CommandParser, changed_options, option, options_of
from stkzoo._os import has_display
from stkzoo.cli import race, race_client, race_server
from stkzoo.cli._race_options import LivePageArguments, VideoArguments, ViewingArguments
from stkzoo.errors import AgentError
from stkzoo.race import RaceListener, RaceResult, RaceSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceSettings(RaceSettings):
    """Settings of a race, with the defaults of pystk2-gymnasium."""

    error_handling: str = "raise"
    action_timeout: float | None = 0.0


@dataclass
class ReferenceVideoArguments(VideoArguments):
    """Options of a video, with the names and defaults of pystk2-gymnasium."""

    video: str | None = option(aliases=("--record",))
    width: int = option(1280, aliases=("--screen-width",))
    height: int = option(720, aliases=("--screen-height",))
    render_sub_steps: int = 1


@dataclass
class ReferencePageArguments(LivePageArguments):
    """Options of the live page, with the defaults of pystk2-gymnasium."""

    web_port: int = 8050


@dataclass
class ReferenceViewingArguments(ViewingArguments):
    """See :class:`ReferenceVideoArguments`."""

    video: ReferenceVideoArguments = options_of(ReferenceVideoArguments, group="video")
    page: ReferencePageArguments = options_of(
        ReferencePageArguments, group="live page in the browser"
    )


@dataclass
class ReferenceRacesArguments(race.RacesArguments):
    """Options of races, with the names and defaults of pystk2-gymnasium."""

    settings: dict[str, Any] = options_of(ReferenceSettings, without=("seed",), group="race")
    num_karts: int | None = 3
    viewing: ReferenceViewingArguments = options_of(ReferenceViewingArguments)


@dataclass
class ReferenceRaceArguments(ReferenceRacesArguments, race.RaceArguments):
    """Options of ``stkzoo pystk2 race``."""


@dataclass
class ReferenceServersArguments(race_client.ServersArguments):
    """Options of the connection to servers, with the defaults of pystk2-gymnasium."""

    timeout: float | None = 60.0


@dataclass
class ReferenceClientArguments(ReferenceRacesArguments, race_client.RaceClientArguments):
    """Options of ``stkzoo pystk2 race-client``."""

    servers: ReferenceServersArguments = options_of(ReferenceServersArguments, group="servers")


@dataclass
class ReferenceServerArguments(race_server.RaceServerArguments):
    """Options of ``stkzoo pystk2 race-server``."""

    settings: dict[str, Any] = options_of(
        ReferenceSettings, only=race_server.SETTINGS, group="agents"
    )


class _Verbose(argparse.Action):
    def __call__(self, *_: object) -> None:
        logging.basicConfig(level=logging.DEBUG)


def add_arguments(parser: CommandParser) -> None:
    """Declares the option before the action."""
    parser.add_argument("-v", "--verbose", action=_Verbose, nargs=0, help="log what happens")


def _race(arguments: ReferenceRaceArguments) -> int:
    """Run a race of agents.

    Runs a race of agents. `stkzoo race --help` describes the drivers.
    """
    return race.run(arguments, **_outputs(arguments))


def _race_server(arguments: ReferenceServerArguments) -> int:
    """Serve agents to races on this or other machines.

    Serves agents to races on this or other machines. `stkzoo race-server --help` describes the
    agents.
    """
    return race_server.run(arguments)


def _race_client(arguments: ReferenceClientArguments) -> int:
    """Run a race with agents on servers."""
    return race_client.run(arguments, **_outputs(arguments))


ACTIONS = (_race, _race_server, _race_client)


class _ReferenceReward(RaceListener):
    def env_options(self) -> dict[str, Any]:
        return {"reward": "reference"}


def _outputs(arguments: ReferenceRacesArguments) -> dict[str, Any]:
    """Returns the outputs of races, and prints notes about differences to pystk2-gymnasium."""
    viewing, notes = arguments.viewing, []
    for options, needed in viewing.unused():
        notes += [f"{name} does nothing without {needed}" for name in changed_options(options)]
    viewing.video = viewing.video if viewing.video.video else ReferenceVideoArguments()
    viewing.page = viewing.page if viewing.page.web else ReferencePageArguments()
    window = viewing.window
    window.window = window.window or (not window.hide and has_display())
    if not (window.hide or window.window):
        notes.append("no window opens, because there is no display")
    if notes:
        print(f"stkzoo pystk2: {'; '.join(notes)}", file=sys.stderr)
    # Replays are checked with stkzoo's own reward.
    return {
        "document": _document,
        "listeners": [_ReferenceReward()] if arguments.replay is None else [],
    }


def _document(results: Sequence[RaceResult], failure: AgentError | None) -> str:
    """Returns the last race's result, or the error that ended it, in pystk2-gymnasium's format."""
    return json.dumps(_failed(failure) if failure else _finished(results[-1]), indent=2)


def _failed(failure: AgentError) -> dict[str, Any]:
    return {
        "type": "error",
        "key": _key(failure.key),
        "name": failure.key,
        "when": "in the race",
        "message": str(failure),
        "traceback": failure.trace.splitlines(keepends=True),
    }


def _finished(result: RaceResult) -> dict[str, Any]:
    rows = [row for row in result.agents if row.source != "ai"]
    return {
        "type": "results",
        "track": result.track,
        "steps": result.steps,
        "elapsed_seconds": round(result.wall_time, 2),
        "results": [
            {
                "key": _key(row.agent),
                "name": row.driver,
                "reward": row.reward,
                "position": row.rank,
                "avg_action_time": row.action_time.mean if row.action_time else 0.0,
            }
            for row in sorted(rows, key=lambda row: _key(row.agent))
        ],
    }


def _key(agent: str) -> int:
    """Returns an agent's number in pystk2-gymnasium, 0 for ``kart_0``; -1 if it is unknown."""
    number = agent.rpartition("_")[2]
    return int(number) if number.isdecimal() else -1
