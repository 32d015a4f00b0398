"""Measures the resident memory of the program, the fork server and the game process.

    python -m benchmarks.bench_memory
    python -m benchmarks.bench_memory --karts 3 --resets 500

Memory is measured after the import, in a race, after a race on every track, and over many resets on
one short track. ``resident`` counts pages that processes share in each of them, ``share`` (the
kernel's proportional set size) divides them among the processes, and ``own`` excludes them: a
forked race shares most of its pages with the fork server. Needs Linux.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.bench_common import (
    Table,
    cores,
    parser,
    progress_bar,
    save,
)
from benchmarks.bench_driver import Contender, Spec
from stkzoo.tracks import SPLITS

KINDS = {"resident": "Rss", "share": "Pss", "own": "Private"}
_NUM_POINTS = 10
_TRACK_STEPS = 10


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser(__doc__, "memory", steps=50, karts=(3,), track="olivermath", cores=1)
    words.add_argument("--resets", type=int, default=500, help="resets on --track (default: 500)")
    words.add_argument(
        "--tracks",
        nargs="+",
        choices=SPLITS["all"],
        default=list(SPLITS["all"]),
        metavar="NAME",
        help="tracks to race on in turn (default: all)",
    )
    options = words.parse_args(arguments)
    if not Path("/proc/self/smaps_rollup").exists():
        words.error("this system has no /proc/<pid>/smaps_rollup, which memory is read from")
    specs = {
        (karts, name): spec
        for karts in options.karts
        for name, spec in _specs(karts, cores(options.cores)).items()
    }
    results = []
    with progress_bar(len(specs) * (len(options.tracks) + options.resets)) as (bar, task):
        for (karts, name), spec in specs.items():
            bar.update(task, description=f"{name}, {karts} karts")
            found = measure(spec, options, lambda: bar.advance(task))
            results.append({"karts": karts, "contender": name, **found})
    save(options.output, "memory", options, results, tables(results))
    return 0


def _specs(karts: int, pinned: tuple[int, ...]) -> dict[str, Spec]:
    def spec(kind: str, api: str, subprocess: bool) -> Spec:
        return Spec(kind, api, "full", karts, karts, subprocess, pinned)

    return {
        "stkzoo, in process": spec("stkzoo", "parallel", False),
        "stkzoo, worker": spec("stkzoo", "parallel", True),
        "reference, in process": spec("reference", "multi", False),
        "reference, subprocess": spec("reference", "multi", True),
    }


def measure(spec: Spec, options: argparse.Namespace, advance: Callable[[], None]) -> dict[str, Any]:
    """Measures the memory of a contender at several stages, and its growth over resets."""
    stages: dict[str, Any] = {}
    with Contender(spec) as contender:
        contender.ask("load")
        stages["after import"] = processes(contender.pid)
        contender.ask("make")
        contender.ask("reset", track=options.track, seed=0)
        contender.ask("steps", count=options.steps)
        stages["in a race"] = processes(contender.pid)
        growth = _growth(contender, options, advance)
        for track in options.tracks:
            contender.ask("reset", track=track, seed=1)
            contender.ask("steps", count=_TRACK_STEPS)
            advance()
        stages["after all tracks"] = processes(contender.pid)
    return {"stages": stages, "growth": growth}


def _growth(
    contender: Contender, options: argparse.Namespace, advance: Callable[[], None]
) -> dict[str, Any] | None:
    """Returns the resident memory by process at some resets, and its total growth [MiB]."""
    if options.resets < 2:
        return None
    points = sorted({max(1, options.resets * n // _NUM_POINTS) for n in range(1, _NUM_POINTS + 1)})
    series: dict[str, list[float]] = {}
    for number in range(1, options.resets + 1):
        contender.ask("reset", track=options.track, seed=number)
        contender.ask("steps", count=1)
        if number in points:
            for name, sizes in processes(contender.pid).items():
                series.setdefault(name, []).append(sizes["resident"])
        advance()
    grown = {name: values[-1] - values[0] for name, values in series.items()}
    return {"resets": points, "resident": series, "grown": grown}


def processes(pid: int) -> dict[str, dict[str, float]]:
    """Returns the memory by role [MiB]; of several processes with one role, that of the newest."""
    roles = ("program", "fork server or game", "race")
    level = [pid]
    found = {}
    for role in roles:
        if not level:
            break
        found[role] = _sizes(level[-1])
        level = sorted(child for parent in level for child in children(parent))
    return found


def children(pid: int) -> list[int]:
    """Returns the process ids of a process's children."""
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        return [int(c) for task in tasks for c in (task / "children").read_text().split()]
    except OSError:
        return []


def _sizes(pid: int) -> dict[str, float]:
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:]
    return {
        kind: sum(int(line.split()[1]) for line in lines if line.startswith(prefix)) / 1024
        for kind, prefix in (("resident", "Rss:"), ("share", "Pss:"), ("own", "Private_"))
    }


def tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Returns a table of the stages and one of the growth."""
    stages = [
        (
            result["contender"],
            str(result["karts"]),
            stage,
            role,
            *(f"{sizes[kind]:.1f}" for kind in KINDS),
        )
        for result in results
        for stage, roles in result["stages"].items()
        for role, sizes in roles.items()
    ]
    growth = [
        (
            result["contender"],
            str(result["karts"]),
            role,
            f"{result['growth']['resets'][0]} to {result['growth']['resets'][-1]}",
            f"{values[0]:.1f}",
            f"{values[-1]:.1f}",
            f"{result['growth']['grown'][role]:+.2f}",
        )
        for result in results
        if result["growth"]
        for role, values in result["growth"]["resident"].items()
    ]
    columns = ("", "karts", "when", "process", *KINDS)
    changes = ("", "karts", "process", "resets", "first", "last", "grown")
    made = [Table("memory [MiB]", columns, stages)]
    return made + ([Table("resident memory over resets [MiB]", changes, growth)] if growth else [])


if __name__ == "__main__":
    sys.exit(main())
