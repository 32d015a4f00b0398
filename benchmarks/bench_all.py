"""Runs all benchmarks one after another.

    python -m benchmarks.bench_all
    python -m benchmarks.bench_all --only steps transport
    python -m benchmarks.bench_all --quick --output trial

The results are JSON files in one folder. ``--steps`` and ``--karts`` override the defaults of every
benchmark; each command shows them with ``--help``.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from benchmarks.bench_common import RESULTS, progress_bar
from stkzoo._arguments import CommandParser

#: Benchmarks in the order in which they run, with the arguments of ``--quick``.
BENCHMARKS: dict[str, tuple[str, ...]] = {
    "steps": ("--steps", "10", "--karts", "2", "--view", "flattened", "--single-karts", "2"),
    "transport": ("--steps", "10", "--karts", "2"),
    "resets": ("--steps", "1", "--rounds", "1"),
    "memory": ("--steps", "5", "--resets", "4", "--tracks", "zengarden"),
    "vector": ("--steps", "5", "--rounds", "1", "--karts", "2", "--races", "2"),
    "states": ("--steps", "1", "--karts", "2"),
    "scaling": ("--steps", "10", "--karts", "3", "--view", "flattened", "--tracks", "zengarden"),
    "learners": (
        "--iterations",
        "1",
        "--rounds",
        "1",
        "--steps",
        "10",
        "--karts",
        "2",
        "--races",
        "1",
    ),
}


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = CommandParser(prog="python -m benchmarks.bench_all", description=__doc__)
    words.add_argument("--only", nargs="+", choices=list(BENCHMARKS), default=list(BENCHMARKS))
    words.add_argument("--quick", action="store_true", help="trial run; figures mean nothing")
    words.add_argument("--steps", type=int, metavar="N", help="measured steps of each contender")
    words.add_argument("--karts", type=int, nargs="+", metavar="K", help="numbers of karts")
    words.add_argument("--output", type=Path, default=RESULTS, help="folder of the JSON files")
    options = words.parse_args(arguments)
    failed = []
    with progress_bar(len(options.only)) as (bar, task):
        for name in options.only:
            bar.update(task, description=name)
            bar.stop()  # each benchmark shows its own bar
            if _run(name, options) != 0:
                failed.append(name)
            bar.start()
            bar.advance(task)
    if failed:
        print(f"failed, or contenders drove different races: {', '.join(failed)}", file=sys.stderr)
    return int(bool(failed))


def _run(name: str, options: argparse.Namespace) -> int:
    command = [sys.executable, "-m", f"benchmarks.bench_{name}"]
    command += ["--output", str((options.output / f"{name}.json").resolve())]
    command += BENCHMARKS[name] if options.quick else ()
    if options.steps is not None:
        command += ["--steps", str(options.steps)]
    if options.karts is not None:
        command += ["--karts", *map(str, options.karts)]
    print(f"== {name}", flush=True)
    return subprocess.run(  # noqa: S603 - our own interpreter and words
        command, cwd=Path(__file__).parents[1], check=False
    ).returncode


if __name__ == "__main__":
    sys.exit(main())
