"""Checks that races with the same seed are equal bit for bit, on every track up to the finish.

Three agents (the heuristic driver with seeded noise) race against three of the game's bots. The
same seed is raced three times in one environment, once in another, and once in a new
program. All observations, rewards, ends, infos and the global state must be equal bit for bit at
every step. A race with another seed must differ.

    python -m benchmarks.determinism
    python -m benchmarks.determinism --track zengarden lighthouse --seed 3
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_common import Table, print_tables, progress_bar
from stkzoo import RaceParallelEnv, race_v0
from stkzoo._arguments import CommandParser
from stkzoo.agents.heuristic import create_state, get_actor
from stkzoo.checks import Step, Trace, first_difference, play, trace
from stkzoo.checks.play import fingerprint
from stkzoo.checks.processes import run_fresh
from stkzoo.tracks import SPLITS

RESULTS = Path(__file__).parent / "results" / "determinism.json"
NUM_AGENTS = 3
NUM_KART = 6
MAX_STEPS = 4000
#: Enough segments for the driver; fewer than the whole track save time.
MAX_PATHS = 60


@dataclass(frozen=True)
class Result:
    """Results of one track. A comparison is empty if the races are equal.

    Attributes:
        track: name of the track.
        steps: length of the race.
        finished: number of agents that crossed the finish line.
        same_env: first differences between the races of one environment.
        other_env: first difference from the race in another environment.
        fresh_program: first difference from the race in a new program.
        other_seed_differs: whether another seed gave another race.
        seconds: duration of all races [s].
    """

    track: str
    steps: int
    finished: int
    same_env: str
    other_env: str
    fresh_program: str
    other_seed_differs: bool
    seconds: float

    @property
    def is_right(self) -> bool:
        """Whether all checks passed."""
        differences = self.same_env or self.other_env or self.fresh_program
        return not differences and self.other_seed_differs and self.finished == NUM_AGENTS


class NoisyDrivers:
    """A heuristic driver for each agent, with noise on the steering and random shots."""

    def __init__(self) -> None:
        self._drive = get_actor(None, None, None)

    def __call__(self, step: Step) -> dict[str, Any]:
        """Returns the actions by agent."""
        if step.number == 0:
            self._states = {agent: create_state() for agent in step.agents}
            self._random = {
                agent: np.random.default_rng([0, i]) for i, agent in enumerate(step.agents)
            }
        return {agent: self._act(agent, step.observations[agent]) for agent in step.agents}

    def _act(self, agent: str, observation: Any) -> dict[str, Any]:
        action = dict(self._drive(self._states[agent], observation))
        random = self._random[agent]
        steer = np.asarray(action["steer"], np.float32) + random.normal(0.0, 0.05)
        action["steer"] = np.clip(steer, -1.0, 1.0).astype(np.float32)
        action["fire"] = int(random.random() < 0.1)
        return action


def make_env(track: str) -> RaceParallelEnv:
    """Returns the environment of a track."""
    return race_v0.parallel_env(
        agents=NUM_AGENTS,
        num_kart=NUM_KART,
        track=track,
        max_paths=MAX_PATHS,
        max_cycles=MAX_STEPS,
    )


def drive(env: RaceParallelEnv, seed: int) -> tuple[Trace, int]:
    """Drives a race to the finish; returns its trace and the number of agents that finished."""
    finished = 0

    def steps() -> Iterator[Step]:
        nonlocal finished
        for step in play(env, seed, policy=NoisyDrivers()):
            finished += sum(step.terminations.values())
            states.append(fingerprint(env.state()))
            yield step

    states: list[str] = []
    record = trace(steps())
    for step, state in zip(record, states, strict=True):
        step["state()"] = state
    return record, finished


def drive_alone(track: str, seed: int) -> Trace:
    """Drives a race in a new environment; returns its trace."""
    with closing(make_env(track)) as env:
        return drive(env, seed)[0]


def examine(track: str, seed: int) -> Result:
    """Drives and compares all races of a track."""
    start = time.perf_counter()
    with closing(make_env(track)) as env:
        first, finished = drive(env, seed)
        again = [drive(env, seed)[0] for _ in range(2)]
        other_seed = drive(env, seed + 1)[0]
    return Result(
        track=track,
        steps=len(first) - 1,
        finished=finished,
        same_env="; ".join(filter(None, (first_difference(first, race) for race in again))),
        other_env=first_difference(first, drive_alone(track, seed)) or "",
        fresh_program=first_difference(first, run_fresh(drive_alone, track, seed)[0]) or "",
        other_seed_differs=first_difference(first, other_seed) is not None,
        seconds=round(time.perf_counter() - start, 2),
    )


def main() -> int:
    """Runs the command; returns its exit code."""
    parser = CommandParser(prog="python -m benchmarks.determinism", description=__doc__)
    parser.add_argument(
        "--track", nargs="+", choices=SPLITS["all"], default=SPLITS["all"], metavar="NAME"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the races (default: 1)")
    parser.add_argument("--output", type=Path, default=RESULTS, help="JSON file to write")
    options = parser.parse_args()
    results = list(_with_progress(options.track, options.seed))
    options.output.parent.mkdir(parents=True, exist_ok=True)
    report = {"seed": options.seed, "tracks": [asdict(result) for result in results]}
    options.output.write_text(json.dumps(report, indent=2) + "\n")
    print_tables([_table(results)])
    print(f"written to {options.output}")
    return int(not all(result.is_right for result in results))


def _with_progress(tracks: list[str], seed: int) -> Iterator[Result]:
    with progress_bar(len(tracks)) as (progress, task):
        for track in tracks:
            progress.update(task, description=track)
            result = examine(track, seed)
            verdict = "reproduced" if result.is_right else "NOT the same race"
            progress.console.print(f"{track} ({result.seconds:.0f} s): {verdict}", highlight=False)
            progress.advance(task)
            yield result


def _table(results: list[Result]) -> Table:
    title = "Same seed, same race: 3 agents, 3 bots, to the finish"
    columns = ("track", "steps", "finished", "one env", "other env", "fresh program", "other seed")
    rows = [
        (
            result.track,
            str(result.steps),
            f"{result.finished}/{NUM_AGENTS}",
            result.same_env or "same",
            result.other_env or "same",
            result.fresh_program or "same",
            "differs" if result.other_seed_differs else "SAME",
        )
        for result in results
    ]
    return Table(title, columns, rows)


if __name__ == "__main__":
    sys.exit(main())
