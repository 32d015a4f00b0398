"""Measures how much time thinned scenes save in a step of the engine, on every track.

The benchmark builds two headless packs from the full data: one with whole scenes and one with
thinned scenes (`stkzoo.engine.assets.scenes`). Then it runs two kinds of races on each track:

- Timed races: blocks of steps with both packs in turn. The time is the CPU time of the engine's own
  step, including some microseconds for reading all karts and items.
- Compared races, for each seed, forward and in reverse: half of the karts are the game's bots; the
  others drive at random, use items and nitro, and call for rescue. All karts and items must be
  equal, bit for bit, at every step. If the two races differ, they run again in new processes: a few
  races have several outcomes with the same pack, because the engine orders touching karts by their
  memory addresses.

    python -m benchmarks.bench_engine
    python -m benchmarks.bench_engine --track black_forest --seeds 2 --steps 200

The file is written after every timed track and after every seed.
"""

from __future__ import annotations

import hashlib
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.bench_common import Table, parser, print_tables, progress_bar, save
from benchmarks.bench_driver import Interpreter
from stkzoo.engine.assets import Progress, find_assets
from stkzoo.engine.assets.headless import build_headless
from stkzoo.engine.process import engine_environment
from stkzoo.engine.setup import KartSetup, RaceSetup
from stkzoo.tracks import SPLITS

#: Consecutive steps of one pack in its turn, and steps before the measured ones.
BLOCK, WARMUP = 20, 40
#: Timed races of each track; their times are pooled.
ROUNDS = 3
#: Karts of compared races, and number of new interpreters of each pack if a race differs.
COMPARED, FRESH = 6, 12
RESAMPLES = 2000
BEFORE, AFTER = "whole scenes", "thinned scenes"


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser(__doc__, "engine", steps=300, karts=(10,), track=SPLITS["all"])
    words.add_argument("--seeds", type=int, default=20, help="of compared races (default: 20)")
    words.add_argument("--length", type=int, default=200, help="steps of each (default: 200)")
    options = words.parse_args(arguments)
    results: dict[str, dict[str, Any]] = {}
    with (
        _packs() as roots,
        _Contender(roots[BEFORE]) as before,
        _Contender(roots[AFTER]) as after,
        progress_bar((2 * options.seeds + ROUNDS) * len(options.track)) as (bar, task),
    ):
        both = {BEFORE: before, AFTER: after}
        for track in options.track:
            bar.update(task, description=f"{track}, timed")
            results[track] = _time(both, track, options.steps, options.karts[0])
            bar.advance(task, ROUNDS)
            save(options.output, "engine", options, list(results.values()))
        for seed in range(1, options.seeds + 1):
            bar.update(task, description=f"seed {seed}")
            for track in options.track:
                _compare(both, roots, results[track], seed, options.length)
                bar.advance(task, 2)
            save(options.output, "engine", options, list(results.values()))
    print_tables(tables(list(results.values())))
    return int(any(result["parted"] for result in results.values()))


@contextmanager
def _packs() -> Iterator[dict[str, Path]]:
    full = find_assets(graphics=True).root
    with tempfile.TemporaryDirectory(prefix="stkzoo-bench-") as folder:
        roots = {BEFORE: Path(folder, "before"), AFTER: Path(folder, "after")}
        for name, root in roots.items():
            root.mkdir()
            build_headless(full, root, Progress(), has_whole_scenes=name == BEFORE)
        yield roots


def _compare(
    both: Mapping[str, _Contender],
    roots: Mapping[str, Path],
    result: dict[str, Any],
    seed: int,
    length: int,
) -> None:
    """Runs the races of one track and seed with both packs, and records those that differ."""
    for reverse in (False, True):
        race = {"track": result["track"], "seed": seed, "reverse": reverse, "karts": COMPARED}
        ends = [one.ask("race", **race, steps=length) for one in both.values()]
        result["races"] += 1
        if ends[0] != ends[1]:
            kind = "unstable" if is_unstable(roots, race, length) else "parted"
            result[kind].append(race)


def is_unstable(roots: Mapping[str, Path], race: Mapping[str, Any], length: int) -> bool:
    """Returns whether new processes with both packs have an outcome in common.

    The engine orders touching karts by their memory addresses, so the outcome of a few races
    differs between processes with the same pack.
    """
    outcomes: dict[str, set[str]] = {name: set() for name in roots}
    for _ in range(FRESH):
        for name, root in roots.items():
            with _Contender(root) as one:
                outcomes[name].add(one.ask("race", **race, steps=length))
    return bool(outcomes[BEFORE] & outcomes[AFTER])


def _time(both: Mapping[str, _Contender], track: str, steps: int, karts: int) -> dict[str, Any]:
    times: dict[str, list[float]] = {name: [] for name in both}
    starts: dict[str, list[float]] = {name: [] for name in both}
    memory: dict[str, list[float]] = {name: [] for name in both}
    parted = []
    for seed in range(1, ROUNDS + 1):
        race = {"track": track, "seed": seed, "reverse": False, "karts": karts}
        for name, one in both.items():
            starts[name].append(one.ask("begin", **race)["seconds"])
            one.ask("steps", count=WARMUP)
        for turn in range(-(-steps // (ROUNDS * BLOCK))):
            for name in sorted(both, reverse=bool(turn % 2)):
                times[name].append(both[name].ask("steps", count=BLOCK)["seconds"] / BLOCK)
        ends = {name: one.ask("end") for name, one in both.items()}
        for name, end in ends.items():
            memory[name].append(end["private"])
        parted += [race] if ends[BEFORE]["digest"] != ends[AFTER]["digest"] else []
    ratio, low, high = speedup(times[BEFORE], times[AFTER])
    return {
        "track": track,
        "races": ROUNDS,
        "parted": parted,
        "unstable": [],
        "step_us": {name: 1e6 * statistics.median(found) for name, found in times.items()},
        "speedup": {"ratio": ratio, "low": low, "high": high},
        "start_ms": {name: 1e3 * statistics.median(found) for name, found in starts.items()},
        "private_mb": {name: statistics.median(found) for name, found in memory.items()},
    }


def speedup(before: Sequence[float], after: Sequence[float]) -> tuple[float, float, float]:
    """Returns the speedup and its 95% interval, from resampled pairs of blocks."""
    pairs = np.array([before, after])
    random = np.random.default_rng(0)
    drawn = random.integers(pairs.shape[1], size=(RESAMPLES, pairs.shape[1]))
    sums = pairs[:, drawn].sum(axis=-1)
    low, high = np.quantile(sums[0] / sums[1], (0.025, 0.975))
    return float(pairs[0].sum() / pairs[1].sum()), float(low), float(high)


def tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Returns the results as a table with one row per track."""
    columns = ("track", "step", "thinned", "times as fast", "start", "thinned", "equal races")
    rows = []
    for result in results:
        step, start, ratio = result["step_us"], result["start_ms"], result["speedup"]
        races, parted = result["races"], len(result["parted"]) + len(result["unstable"])
        rows.append(
            (
                result["track"],
                f"{step[BEFORE]:.0f}",
                f"{step[AFTER]:.0f}",
                f"{ratio['ratio']:.2f} ({ratio['low']:.2f}..{ratio['high']:.2f})",
                f"{start[BEFORE]:.0f}",
                f"{start[AFTER]:.0f}",
                f"{races - parted}/{races}",
            )
        )
    unstable = sum(len(result["unstable"]) for result in results)
    note = f"The {unstable} other races have several outcomes, and the packs share some."
    title = "The engine's own step (µs) and race start (ms), with whole and with thinned scenes"
    return [Table(title, columns, rows, note if unstable else "")]


class _Contender(Interpreter):
    """An interpreter with the engine and one pack; it forks a process for each race."""

    def __init__(self, root: Path) -> None:
        self._home = tempfile.TemporaryDirectory(prefix="stkzoo-bench-")
        words = ["-c", "from benchmarks.bench_engine import serve; serve()"]
        super().__init__(f"the engine in {root}", words, engine_environment(root, self._home.name))

    def close(self) -> None:
        """Ends the interpreter and removes the game's settings."""
        super().close()
        self._home.cleanup()


def serve() -> None:
    """Answers requests from standard input; each race runs in its own process."""
    from stkzoo.engine.race import init_engine

    replies = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the game prints to stdout
    init_engine()
    while line := sys.stdin.readline():
        pid = os.fork()
        if pid == 0:
            try:
                _serve_race(json.loads(line), lambda reply: print(reply, file=replies, flush=True))
            finally:
                os._exit(0)
        if os.waitpid(pid, 0)[1]:
            return


def _serve_race(request: dict[str, Any], reply: Callable[[str], None]) -> None:
    is_timed = request.pop("do") == "begin"
    count = request.pop("steps", 0)
    race = _DrivenRace(**request)
    if not is_timed:
        race.step(count)
        reply(json.dumps(race.digest.hexdigest()))
        return
    reply(json.dumps({"seconds": race.start_seconds}))
    while (request := json.loads(sys.stdin.readline()))["do"] == "steps":
        reply(json.dumps({"seconds": race.step(request["count"])}))
    reply(json.dumps({"digest": race.digest.hexdigest(), "private": _private_megabytes()}))


class _DrivenRace:
    """A race in this process: bots, and players with smooth random steering at full throttle."""

    def __init__(self, track: str, seed: int, reverse: bool, karts: int) -> None:
        from stkzoo.engine.race import GameRace

        self._players = karts // 2
        setups = tuple(KartSetup(is_bot=place >= self._players) for place in range(karts))
        setup = RaceSetup(
            track, setups, laps=3, reverse=reverse, seed=seed, difficulty=1 + seed % 3
        )
        start = time.process_time()
        self._race = GameRace(setup)
        self.digest = hashlib.sha256(self._race.begin().snapshot.data)
        self.start_seconds = time.process_time() - start
        self._random = np.random.default_rng(seed)
        self._steer = np.zeros(self._players)

    def step(self, count: int) -> float:
        """Makes ``count`` steps; returns their CPU time [s]."""
        seconds = 0.0
        for _ in range(count):
            controls = self._controls()
            start = time.thread_time()
            snapshot = self._race.step(controls)
            seconds += time.thread_time() - start
            self.digest.update(snapshot.data)
        return seconds

    def _controls(self) -> npt.NDArray[np.float32]:
        self._steer = np.clip(
            0.8 * self._steer + self._random.normal(0.0, 0.25, self._players), -1, 1
        )
        controls = np.zeros((self._players, 7), np.float32)
        controls[:, 0], controls[:, 1] = 1.0, self._steer
        # brake, drift, fire, nitro, rescue
        chances = (0.02, 0.1, 0.2, 0.2, 0.005)
        controls[:, 2:] = self._random.random((self._players, 5)) < chances
        return controls


def _private_megabytes() -> float:
    try:
        lines = Path("/proc/self/smaps_rollup").read_text().splitlines()
    except OSError:
        return float("nan")
    found = (line.split() for line in lines if line.startswith("Private_"))
    return sum(int(words[1]) for words in found) / 1024


if __name__ == "__main__":
    sys.exit(main())
