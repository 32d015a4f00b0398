"""Races two drivers against hostile agents, and checks that nothing is left behind.

    python -m benchmarks.adversaries               # 200 races, about 40 minutes
    python -m benchmarks.adversaries --races 6     # each adversary twice
    python -m benchmarks.adversaries --cup 100     # a tournament instead

Each race has two ordinary drivers and several adversaries in bubblewrap's sandbox. The results of
the two drivers must equal those of a race in which the other agents only fail at the same steps. At
the end, no process, file, descriptor or thread of any race may remain.

In the tournament, one agent kills, stops, floods or bombs its race whenever it is behind. No race
may be void, and the agent must be rated last.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from itertools import cycle, islice
from pathlib import Path

from stkzoo._arguments import CommandParser
from stkzoo.evaluation import TournamentResult, run_tournament
from stkzoo.race import AgentResult, RaceResult, run_race
from tests.support.adversaries import (
    ADVERSARIES,
    groups,
    write_adversary,
    write_quitter,
    write_sore_loser,
)
from tests.support.processes import children_of, wait_until

GOOD = (str(Path(__file__).parents[1] / "tests" / "data" / "agents" / "plain"), "heuristic")
_GROUP = 18
_FOLDERS = ("/tmp", "/dev/shm")  # noqa: S108 - where adversaries would leave something
_SETTLE = 10.0  # [s]


def race(drivers: Sequence[str]) -> RaceResult:
    """Runs a short race of the good drivers and others."""
    return run_race(
        [*GOOD, *drivers],
        track="lighthouse",
        seed=1,
        sandbox="on",
        action_timeout=5.0,
        agent_memory=400,
        max_steps=60,
    )


def good_rows(result: RaceResult) -> list[AgentResult]:
    """Returns the results of the good drivers."""
    return [row for row in result.agents if row.driver in ("Plain", "heuristic")]


def problems_of(result: RaceResult, undisturbed: RaceResult) -> list[str]:
    """Returns descriptions of what went wrong in a race with adversaries.

    Args:
        result: result of the race.
        undisturbed: result of the same race with agents that only fail at the same steps.
    """
    found = []
    if good_rows(result) != good_rows(undisturbed):
        found.append("the results of the other drivers differ")
    for row in result.agents:
        if (adversary := ADVERSARIES.get(row.driver)) is None:
            continue
        failure = row.errors[0] if row.errors else None
        if failure is None or row.status != "retired":
            found.append(f"{row.driver!r} was not retired")
        elif failure.step != adversary.step or not re.search(adversary.says, failure.message):
            found.append(f"{row.driver!r} failed at step {failure.step}: {failure.message[:100]}")
    return found


def left_behind(mark: str) -> dict[str, int]:
    """Counts what this program and its agents currently have, by kind."""
    commands = [_text(folder / "cmdline") for folder in Path("/proc").glob("[0-9]*")]
    names = [name for folder in _FOLDERS for name in os.listdir(folder)]
    return {
        "processes": len(children_of(os.getpid())) + sum(mark in text for text in commands),
        "files": sum(mark in name or name.startswith("stkzoo-agent") for name in names),
        "descriptors": len(os.listdir("/proc/self/fd")),
        "threads": threading.active_count(),
    }


def _text(file: Path) -> str:
    try:
        return file.read_text(errors="replace")
    except OSError:
        return ""


def cup(folder: Path, races: int, action_timeout: float = 5.0) -> TournamentResult:
    """Runs a tournament with an agent that attacks its race whenever it is behind.

    Args:
        folder: folder for the agent and the tournament.
        races: number of that agent's races.
        action_timeout: action timeout of each agent [s].
    """
    loser = write_sore_loser(folder, f"stkzoo-adversary-{os.getpid()}")
    return run_tournament(
        [GOOD[0], loser],
        output=folder / "cup",
        tracks=["lighthouse"],
        races=races,
        per_race=2,
        max_steps=60,
        action_timeout=action_timeout,
        sandbox="on",
        plot=False,
    )


def _run_cup(races: int) -> int:
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        result = cup(Path(folder), races)
    ranks = [race.order.index("sore loser") + 1 for race in result.races]
    for row in result.standings:
        print(
            f"{row.label:12} rating {row.rating.value:5.1f}, {row.races} races, {row.errors} errors"
        )
    print(f"{len(ranks)} of {races} races counted; it was last in {ranks.count(2)}")
    print(f"{time.monotonic() - begin:.0f} s")
    is_last = result.standings[-1].label == "sore loser"
    return 0 if result.is_complete and is_last else 1


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the races; returns 1 if an adversary did more than fail."""
    parser = CommandParser(prog="python -m benchmarks.adversaries", description=__doc__)
    parser.add_argument("--races", type=int, default=200, help="races in turn (default: 200)")
    parser.add_argument("--cup", type=int, metavar="RACES", help="run a tournament instead")
    arguments = parser.parse_args(argv)
    if arguments.cup:
        return _run_cup(arguments.cup)
    mark, failed = f"stkzoo-adversary-{os.getpid()}", 0
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        place, teams = Path(folder), groups(_GROUP)
        quiet = {names[0]: race([write_quitter(place, name) for name in names]) for names in teams}
        before = left_behind(mark)
        for number, names in enumerate(islice(cycle(teams), arguments.races), 1):
            result = race([write_adversary(place, name, mark) for name in names])
            found = problems_of(result, quiet[names[0]])
            failed += bool(found)
            for text in found:
                print(f"race {number}: {text}", flush=True)
        wait_until(lambda: left_behind(mark) == before, _SETTLE)
        left = {kind: count - before[kind] for kind, count in left_behind(mark).items()}
    print(f"{len(ADVERSARIES)} adversaries, {arguments.races} races, {failed} with a problem")
    print("left: " + ", ".join(f"{count} {kind}" for kind, count in left.items()))
    print(f"{time.monotonic() - begin:.0f} s")
    return 1 if failed or any(left.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
