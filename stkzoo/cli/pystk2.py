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
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from stkzoo._arguments import CommandParser
from stkzoo._os import has_display
from stkzoo.cli import race, race_client, race_server
from stkzoo.cli._arguments import add_actions
from stkzoo.cli._race_options import LivePageArguments, VideoArguments
from stkzoo.errors import AgentError

if TYPE_CHECKING:
    from stkzoo.race import RaceResult

#: Defaults of pystk2-gymnasium that differ from those of `stkzoo race`.
_DEFAULTS = {
    "num_karts": 3,
    "error_handling": "raise",
    "action_timeout": 0.0,
    "width": 1280,
    "height": 720,
    "render_sub_steps": 1,
    "web_port": 8050,
}

#: Names of pystk2-gymnasium's options, and the corresponding values of `stkzoo race`.
_NAMES = {"--record": "video", "--screen-width": "width", "--screen-height": "height"}


def add_arguments(parser: CommandParser) -> None:
    """Declares the arguments."""
    parser.add_argument("-v", "--verbose", action="store_true", help="log what happens")
    local, server, client = add_actions(parser, _race, _race_server, _race_client)
    race.add_arguments(local)
    race_client.add_arguments(client)
    race_server.add_arguments(server)
    for child in (local, client):
        for name, field in _NAMES.items():
            kind = str if field == "video" else int
            child.add_argument(name, dest=field, type=kind, help=argparse.SUPPRESS)
        child.set_defaults(**_DEFAULTS, document=_document)
    client.set_defaults(timeout=60.0)
    server.set_defaults(action_timeout=0.0)


def _race(arguments: argparse.Namespace) -> int:
    """Run a race of agents.

    Runs a race of agents. `stkzoo race --help` describes the drivers.
    """
    _translate(arguments)
    return race.run(arguments)


def _race_client(arguments: argparse.Namespace) -> int:
    """Run a race with agents on servers."""
    _translate(arguments)
    return race_client.run(arguments)


def _race_server(arguments: argparse.Namespace) -> int:
    """Serve agents to races on this or other machines.

    Serves agents to races on this or other machines. `stkzoo race-server --help` describes the
    agents.
    """
    return race_server.run(arguments)


def _translate(arguments: argparse.Namespace) -> None:
    """Converts options to those of ``stkzoo race``, and prints notes about differences."""
    from stkzoo.race import RaceListener

    class ReferenceReward(RaceListener):
        def env_options(self) -> dict[str, Any]:
            return {"reward": "reference"}

    if arguments.replay is None:  # replays are checked with stkzoo's own reward
        arguments.listeners = (ReferenceReward(),)
    if arguments.verbose:
        logging.basicConfig(level=logging.DEBUG)
    notes = []
    for kind, needed, is_used in (
        (VideoArguments, "--video", arguments.video is not None),
        (LivePageArguments, "--web", arguments.web),
    ):
        for entry in () if is_used else fields(kind):
            if getattr(arguments, entry.name) not in (entry.default, _DEFAULTS.get(entry.name)):
                option = "--" + entry.name.replace("_", "-")
                notes.append(f"{option} does nothing without {needed}")
            setattr(arguments, entry.name, entry.default)
    arguments.window = arguments.window or (not arguments.hide and has_display())
    if not (arguments.hide or arguments.window):
        notes.append("no window opens, because there is no display")
    if notes:
        print(f"stkzoo pystk2: {'; '.join(notes)}", file=sys.stderr)


def _document(results: Sequence[RaceResult], failure: AgentError | None, _: object) -> str:
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
