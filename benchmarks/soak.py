"""Drives thousands of races in one program, on all tracks, with random actions and bots.

In each race, it checks that all observations and rewards are finite. After the race, it records
the game's error messages, the memory, and the numbers of open files, threads and processes. One
race in twenty is repeated in another environment and must be equal bit for bit. Each result is
written immediately, and the same command resumes an interrupted run.

    python -m benchmarks.soak                  # 2,000 races, an hour
    python -m benchmarks.soak --races 100 --output soak.jsonl
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import random
import re
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.bench_common import RESULTS, progress_bar, read_rows
from stkzoo import race_v0
from stkzoo._arguments import CommandParser
from stkzoo.engine.assets import find_assets
from stkzoo.errors import StkzooError
from tests.chaos.family import family
from tests.chaos.forms import digest

OUTPUT = RESULTS / "robustness" / "soak.jsonl"
_VIEWS = ("full", "simple", "flattened", "flattened_discrete", "flattened_continuous_actions")
_AGAIN_EVERY, _WHOLE_EVERY = 20, 50
_WHOLE_STEPS = 1500
#: Number of races after which everything that is loaded once has been loaded.
_WARM = 100
#: Error messages of the game.
_COMPLAINT = re.compile(r"\[(?:error|fatal)\s*\]\s*(.{0,80})|(Segmentation fault|terminate called)")


class NotFiniteError(Exception):
    """An observation or a reward is not finite."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Settings of a race, all determined by its number."""

    number: int
    track: str
    num_kart: int
    agents: int
    difficulty: int
    reverse: bool
    view: str
    steps: int
    seed: int

    @classmethod
    def of(cls, number: int, tracks: Sequence[str]) -> Plan:
        """Returns the race with a number."""
        chance = random.Random(f"soak/{number}")
        num_kart = chance.randint(2, 6)
        return cls(
            number=number,
            track=tracks[number % len(tracks)],
            num_kart=num_kart,
            agents=chance.randint(1, num_kart),
            difficulty=chance.randint(0, 3),
            reverse=chance.random() < 0.3,
            view=chance.choice(_VIEWS),
            steps=_WHOLE_STEPS if number % _WHOLE_EVERY == 0 else chance.randint(40, 120),
            seed=chance.randrange(2**31),
        )


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the missing races and prints the figures."""
    words = CommandParser(prog="python -m benchmarks.soak", description=__doc__)
    words.add_argument("--races", type=int, default=2000, metavar="N", help="total races")
    words.add_argument("--output", type=Path, default=OUTPUT, help="JSON lines file")
    arguments = words.parse_args(argv)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    rows = read_rows(arguments.output)
    tracks = find_assets().tracks
    program = 1 + max((row["program"] for row in rows), default=0)
    with progress_bar(arguments.races) as (progress, task), arguments.output.open("a") as file:
        for number in range(len(rows), arguments.races):
            progress.update(task, completed=number)
            row = {"program": program, **_race(Plan.of(number, tracks)), **_burden()}
            file.write(json.dumps(row) + "\n")
            file.flush()
        progress.update(task, completed=arguments.races)
    gc.collect()
    left = [member for member in family(os.getpid()) if member.kind != "fork server"]
    rows = read_rows(arguments.output)
    _show(rows)
    print(f"processes besides the fork server at the end: {len(left)}")
    return 1 if left or any(row["events"] or row["problem"] for row in rows) else 0


# ---------------------------------------------------------------------- one race


def _race(plan: Plan) -> dict[str, Any]:
    """Runs a race, some of them twice; returns the results."""
    begin = time.monotonic()
    row: dict[str, Any] = {**asdict(plan), "again": False, "problem": "", "events": []}
    try:
        row["driven"], first, complaints = _drive(plan)
        row["complaints"] = complaints
        if plan.number % _AGAIN_EVERY == 7:
            row["again"] = True
            if _drive(plan)[1] != first:
                row["problem"] = "the race differs when it is run again"
    except StkzooError as error:
        row["events"] = [f"{type(error).__name__}: {error}"[:500]]
    except NotFiniteError as error:
        row["problem"] = f"not finite: {error}"
    return {**row, "seconds": round(time.monotonic() - begin, 2)}


def _drive(plan: Plan) -> tuple[int, str, dict[str, int]]:
    """Drives a race; returns its steps, a digest of all results, and the game's errors by text."""
    with race_v0.parallel_env(
        num_kart=plan.num_kart,
        agents=plan.agents,
        track=plan.track,
        difficulty=plan.difficulty,
        reverse=plan.reverse,
        view=plan.view,
        max_cycles=plan.steps,
    ) as env:
        seen = [digest(env.reset(seed=plan.seed))]
        for number, agent in enumerate(env.possible_agents):
            env.action_space(agent).seed(plan.seed % 2**20 + number)
        while env.agents:
            actions = {agent: env.action_space(agent).sample() for agent in env.agents}
            result = env.step(actions)
            if not _is_finite([result[0], [np.array(reward) for reward in result[1].values()]]):
                raise NotFiniteError("an observation or a reward")
            seen.append(digest(result))
        return len(seen) - 1, digest(seen), _complaints(env)


def _is_finite(value: Any) -> bool:
    if isinstance(value, dict):
        return all(map(_is_finite, value.values()))
    if isinstance(value, (tuple, list)):
        return all(map(_is_finite, value))
    is_float = isinstance(value, np.ndarray) and value.dtype.kind == "f"
    return bool(np.isfinite(value).all()) if is_float else True


def _complaints(env: Any) -> dict[str, int]:
    """Returns the numbers of the game's error messages, by text without digits."""
    log = env._session._process.log.tail()
    found = (match[1] or match[2] for match in _COMPLAINT.finditer(log))
    return dict(Counter(re.sub(r"\d+", "#", text) for text in found))


# ---------------------------------------------------------------------- resources


def _burden() -> dict[str, Any]:
    members = family(os.getpid())
    (fork_server,) = [member.pid for member in members if member.kind == "fork server"] or [0]
    return {
        "memory": round(_memory("self"), 2),
        "fork_server_memory": round(_memory(str(fork_server)), 2) if fork_server else 0.0,
        "open_files": len(os.listdir("/proc/self/fd")),
        "fork_server_files": len(_listed(f"/proc/{fork_server}/fd")) if fork_server else 0,
        "threads": threading.active_count(),
        "processes": len(members),
    }


def _memory(pid: str) -> float:
    """Returns the resident memory of a process [MB]; 0 if it does not exist."""
    with contextlib.suppress(OSError):
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096 / 1e6
    return 0.0


def _listed(folder: str) -> list[str]:
    with contextlib.suppress(OSError):
        return os.listdir(folder)
    return []


# ---------------------------------------------------------------------- the figures


def _show(rows: Sequence[Mapping[str, Any]]) -> None:
    table = Table(box=box.SIMPLE, show_header=False)
    for name, figure in _figures(rows):
        table.add_row(name, figure)
    Console(width=140).print(table)


def _figures(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    driven = [row for row in rows if "driven" in row]
    yield "races", f"{len(rows)} on {len({row['track'] for row in rows})} tracks"
    yield "steps", f"{sum(row['driven'] for row in driven):,}"
    yield "driven again", f"{sum(row['again'] for row in rows)}"
    for row in rows:
        for text in (*row["events"], row["problem"]):
            if text:
                yield f"race {row['number']} on {row['track']}", text
    complaints: Counter[str] = Counter()
    for row in driven:
        complaints.update(row["complaints"])
    for text, count in complaints.most_common():
        yield "the game wrote", f"{text} ({count} times)"
    if not complaints:
        yield "the game wrote", "no error"
    for program in sorted({row["program"] for row in rows}):
        yield from _trend([row for row in rows if row["program"] == program])


def _trend(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yields the growth of a program's resources after the warm-up."""
    warm = rows[_WARM:]
    if len(warm) < 2:
        return
    yield f"program {rows[0]['program']}", f"races {warm[0]['number']} to {warm[-1]['number']}"
    numbers = [row["number"] for row in warm]
    for name in (
        "memory",
        "fork_server_memory",
        "open_files",
        "fork_server_files",
        "threads",
        "processes",
    ):
        values = [row[name] for row in warm]
        slope = float(np.polyfit(numbers, values, 1)[0]) * 1000
        low, high = min(values), max(values)
        yield f"  {name}", f"{low:g} to {high:g}, {slope:+.2f} in 1,000 races"


if __name__ == "__main__":
    sys.exit(main())
