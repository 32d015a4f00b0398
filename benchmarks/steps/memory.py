"""Resident memory of the program, the fork server and the race. Needs Linux.

``resident`` counts pages that processes share in each of them, ``share`` (the kernel's proportional
set size) divides them among the processes, and ``own`` excludes them: a forked race shares most of
its pages with the fork server.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.common import Result, Table
from benchmarks.contenders.driver import Contender, Spec
from benchmarks.steps.sections import Job, Section
from stkzoo.tracks import SPLITS

_FIGURES = {"resident": "Rss:", "share": "Pss:", "own": "Private_"}
_ROLES = ("program", "fork server or game", "race")
_CONTENDERS = {
    "stkzoo, in process": ("stkzoo", "parallel", False),
    "stkzoo, worker": ("stkzoo", "parallel", True),
    "reference, in process": ("reference", "multi", False),
    "reference, subprocess": ("reference", "multi", True),
}
_RESET_TRACK = "olivermath"
_TRACK_STEPS = 10


def _jobs(options: argparse.Namespace) -> list[Job]:
    return [{"karts": karts, "contender": name} for karts in options.karts for name in _CONTENDERS]


def _measure(job: Job, options: argparse.Namespace) -> Mapping[str, Any]:
    """Measures after the import, in a race, over resets of a short track, and on every track."""
    kind, api, subprocess = _CONTENDERS[job["contender"]]
    spec = Spec(kind, api, "full", job["karts"], job["karts"], subprocess)
    stages: dict[str, Any] = {}
    with Contender(spec) as contender:
        contender.ask("load")
        stages["after import"] = _processes(contender.pid)
        contender.ask("make")
        for number in range(options.steps):
            contender.ask("reset", track=_RESET_TRACK, seed=number)
            contender.ask("steps", count=_TRACK_STEPS)
            if number == 0:
                stages["in a race"] = _processes(contender.pid)
        stages[f"after {options.steps} resets"] = _processes(contender.pid)
        for track in options.track:
            contender.ask("reset", track=track, seed=1)
            contender.ask("steps", count=_TRACK_STEPS)
        stages["after all tracks"] = _processes(contender.pid)
    return {"stages": stages}


def _processes(pid: int) -> dict[str, dict[str, float]]:
    """Returns the memory by role [MiB]; of several processes with one role, that of the newest."""
    level, sizes = [pid], {}
    for role in _ROLES:
        if not level:
            break
        sizes[role] = _sizes(level[-1])
        level = sorted(child for parent in level for child in _children(parent))
    return sizes


def _children(pid: int) -> list[int]:
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        return [int(c) for task in tasks for c in (task / "children").read_text().split()]
    except OSError:
        return []


def _sizes(pid: int) -> dict[str, float]:
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:]
    return {
        figure: sum(int(line.split()[1]) for line in lines if line.startswith(prefix)) / 1024
        for figure, prefix in _FIGURES.items()
    }


def _tables(results: Sequence[Result]) -> list[Table]:
    rows = [
        (
            result["contender"],
            str(result["karts"]),
            stage,
            role,
            *(f"{sizes[figure]:.1f}" for figure in _FIGURES),
        )
        for result in results
        for stage, roles in result["stages"].items()
        for role, sizes in roles.items()
    ]
    return [Table("memory [MiB]", ("", "karts", "when", "process", *_FIGURES), rows)]


MEMORY = Section(
    "memory of the program, the fork server and the race, over resets and tracks",
    _jobs,
    _measure,
    _tables,
    {"steps": 500, "karts": [3], "track": list(SPLITS["all"])},
    {"steps": 2, "karts": [2], "track": ["zengarden"]},
)
