"""Compares a race over two servers on this machine with the same local race.

    python -m benchmarks.bench_remote
    python -m benchmarks.bench_remote --steps 300 --rounds 5

Four karts race on one track; each server drives two of them, or all four are driven locally.
Contenders take turns, so that a busy machine slows all of them equally. ``files`` are agents from
files in the ``flattened_discrete`` view, each in its own process on either side. ``heuristic`` is
the driver of that name; it uses ``full`` and runs in the server's process or in the race's. The
benchmark measures the time between steps and checks that the results are equal.
"""

from __future__ import annotations

import argparse
import contextlib
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.bench_common import RESULTS, Table, print_tables, save
from stkzoo._arguments import CommandParser
from stkzoo.race import Driver, RaceListener, RaceProgress, find_driver, run_race
from stkzoo.race.remote import RemoteDriverGroup

_AGENT = """\
env_name = "supertuxkart/flattened_discrete-v0"

def get_actor(module_dir, observation_space, action_space):
    return lambda state, observation: action_space.sample()
"""

#: Maximum additional time of a step in a networked race [ms].
ALLOWED = 1.5


class StepTimes(RaceListener):
    """Records the time at the end of each step [s]."""

    def __init__(self) -> None:
        self.marks: list[float] = []

    def started(self, race: RaceProgress) -> None:
        """Starts the clock."""
        del race
        self.marks = [time.perf_counter()]

    def stepped(self, race: RaceProgress) -> None:
        """Records a step."""
        del race
        self.marks.append(time.perf_counter())

    @property
    def mean(self) -> float:
        """Mean duration of a step [ms]."""
        return 1000 * (self.marks[-1] - self.marks[0]) / (len(self.marks) - 1)


@contextlib.contextmanager
def _servers(agents: Sequence[str]) -> Iterator[list[str]]:
    """Starts two servers with two agents each; yields their addresses."""
    command = [sys.executable, "-m", "stkzoo", "race-server", "--address", "127.0.0.1:*", "--quiet"]
    with contextlib.ExitStack() as life:
        addresses = []
        for pair in (agents[:2], agents[2:]):
            server = subprocess.Popen([*command, *pair], stdout=subprocess.PIPE, text=True)  # noqa: S603
            life.enter_context(server)
            life.callback(server.terminate)
            assert server.stdout is not None  # noqa: S101 - it is a pipe
            addresses.append(server.stdout.readline().split(" at ")[1].strip())
        yield addresses


def _race(drivers: Sequence[Driver], track: str, steps: int) -> tuple[float, object]:
    times = StepTimes()
    result = run_race(drivers, listeners=[times], track=track, seed=1, max_steps=steps)
    if result.has_errors:
        raise SystemExit(f"an agent failed: {result.to_json()}")
    rows = [(row.agent, row.rank, row.distance, row.reward) for row in result.agents]
    return times.mean, rows


def _compare(agents: Sequence[str], options: argparse.Namespace) -> dict[str, Any]:
    here, there = [], []
    local = [find_driver(agent) for agent in agents]
    with _servers(agents) as addresses, RemoteDriverGroup(addresses) as group:
        for _ in range(options.rounds):
            mean, rows = _race(local, options.track, options.steps)
            here.append(mean)
            mean, others = _race(group.drivers, options.track, options.steps)
            there.append(mean)
            if rows != others:
                raise SystemExit("the networked race went another way than the local one")
    more = statistics.median(there) - statistics.median(here)
    return {
        "local": [round(mean, 4) for mean in here],
        "networked": [round(mean, 4) for mean in there],
        "median_local": round(statistics.median(here), 4),
        "median_networked": round(statistics.median(there), 4),
        "more": round(more, 4),
        "is_allowed": more <= ALLOWED,
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Runs, prints and saves the comparison; returns 1 if a step costs more than allowed."""
    parser = CommandParser(prog="python -m benchmarks.bench_remote", description=__doc__)
    parser.add_argument("--steps", type=int, default=300, help="steps (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds (default: %(default)s)")
    parser.add_argument("--track", default="lighthouse", help="track (default: %(default)s)")
    parser.add_argument(
        "--output", type=Path, default=RESULTS / "remote.json", help="JSON file to write"
    )
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "pystk_actor.py").write_text(_AGENT)
        found = {
            "files": _compare([folder] * 4, options),
            "heuristic": _compare(["heuristic"] * 4, options),
        }
    results = [{"agents": name, **row} for name, row in found.items()]
    print_tables(tables(results))
    save(options.output, "remote", options, results)
    return 0 if all(row["is_allowed"] for row in results) else 1


def tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Returns the results as a table."""
    columns = ("median_local", "median_networked", "more")
    return [
        Table(
            "4 karts, 2 servers: one step [ms], median of the races' means",
            ("agents", "here", "networked", "more"),
            [
                (result["agents"], *(f"{result[column]:.2f}" for column in columns))
                for result in results
            ],
        )
    ]


if __name__ == "__main__":
    sys.exit(main())
