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
from typing import Any

from stkzoo._arguments import CommandParser
from stkzoo._os import display_problem
from stkzoo.cli import race, race_client, race_server
from stkzoo.cli._race_options import EnvOptions, LivePageArguments, VideoArguments
from stkzoo.errors import AgentError
from stkzoo.race import RaceResult

#: Defaults of pystk2-gymnasium that differ from those of stkzoo, by field.
DEFAULTS = {
    "num_karts": 3,
    "error_handling": "raise",
    "action_timeout": 0.0,
    "timeout": 60.0,
    "width": 1280,
    "height": 720,
    "render_sub_steps": 1,
    "web_port": 8050,
}


class _Verbose(argparse.Action):
    def __call__(self, *_: object) -> None:
        logging.basicConfig(level=logging.DEBUG)


def add_arguments(parser: CommandParser) -> None:
    """Declares the option before the action."""
    parser.add_argument("-v", "--verbose", action=_Verbose, nargs=0, help="log what happens")


def _race(arguments: race.RaceArguments) -> int:
    """Run a race of agents.

    Runs a race of agents. `stkzoo race --help` describes the drivers.
    """
    return race.run(arguments, **_outputs(arguments))


def _race_server(arguments: race_server.RaceServerArguments) -> None:
    """Serve agents to races on this or other machines.

    Serves agents to races on this or other machines. `stkzoo race-server --help` describes the
    agents.
    """
    race_server.run(arguments)


def _race_client(arguments: race_client.RaceClientArguments) -> int:
    """Run a race with agents on servers."""
    return race_client.run(arguments, **_outputs(arguments))


ACTIONS = (_race, _race_server, _race_client)


def _outputs(arguments: race.RacesArguments) -> dict[str, Any]:
    """Returns the outputs of races, and prints notes about differences to pystk2-gymnasium."""
    viewing = arguments.viewing
    notes = viewing.unused(DEFAULTS)
    viewing.video = viewing.video if viewing.video.video else VideoArguments()
    viewing.page = viewing.page if viewing.page.web else LivePageArguments()
    problem = "" if viewing.hide or viewing.window else display_problem()
    viewing.window = viewing.window or not (viewing.hide or problem)
    if problem:
        notes.append(f"no window opens, because {problem}")
    if notes:
        print(f"stkzoo pystk2: {'; '.join(notes)}", file=sys.stderr)
    # Replays are checked with stkzoo's own reward.
    listeners = [EnvOptions(reward="reference")] if arguments.replay is None else []
    return {"document": _document, "listeners": listeners}


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
