"""The action ``stkzoo suite conduct``."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from stkzoo._arguments import positional
from stkzoo.cli._arguments import usage_errors

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stkzoo.suite import RaceConduct


@dataclass
class ConductArguments:
    """Options of ``stkzoo suite conduct``.

    Attributes:
        places: replays, or folders of entries or other batches with replays
        json: write JSON to stdout: each race with its karts and contacts
    """

    places: tuple[str, ...] = positional(metavar="ENTRY_OR_REPLAY")
    json: bool = False


@usage_errors
def conduct(arguments: argparse.Namespace) -> int:
    """Show how karts behave: contacts, whose fault they are, time off the road.

    Runs recorded races again, bit for bit, and counts the environment's events of each kart.
    Touches of the same two karts within a second are judged together. For each contact, copies of
    the race start up to 2 s before it. In each copy, a reference driver takes over one of the two
    karts, and all others repeat their recorded controls. A kart is at fault if both reference
    drivers, ace and scout, avoid the contact in its place, and can start later than in the place
    of the other kart. If both starts are about as late, the kart that closes the gap is at fault.

    The game's AI has no substitute, so it is never at fault. All numbers are means per race.

    Examples:
      stkzoo race heuristic ai ai --seed 1 --replay race.stkz
      stkzoo suite conduct race.stkz
      stkzoo suite conduct suite/versus-my_agent --jobs 1
      stkzoo suite conduct race.stkz --json        each contact with its step

    exit codes:
      0 success, 1 a replay is damaged or not reproducible, 2 invalid command
      line, 130 interrupted
    """
    from stkzoo.cli._batch import run_replays
    from stkzoo.suite import measure_conduct

    races, code = run_replays(arguments, partial(measure_conduct, arguments.places))
    if races is None:
        return code
    if arguments.json:
        print(json.dumps([json.loads(race.to_json()) for race in races], indent=2))
    else:
        _show_conduct(races)
    return code


def _show_conduct(races: Sequence[RaceConduct]) -> None:
    """Prints the mean conduct of each driver."""
    from stkzoo.cli._console import say, show_table
    from stkzoo.suite import mean_conduct

    rows = [
        (
            mean.driver,
            str(mean.races),
            f"{mean.contacts:.2f}",
            "-" if mean.at_fault is None else f"{mean.at_fault:.2f}",
            f"{mean.off_road:.1f}",
            f"{mean.overtakes:.2f}",
        )
        for mean in mean_conduct(races)
    ]
    columns = ("driver", "races", "contacts", "at fault", "off road [s]", "overtakes")
    show_table(columns, rows, left=("driver",), title="per race")
    if skipped := sum(race.not_judged for race in races):
        say(f"{skipped} contacts were not judged: only the first ones of a race are.")
