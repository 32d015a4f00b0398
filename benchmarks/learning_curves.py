"""Compares learning while the actors keep driving with learning in turn with them.

    python -m benchmarks.learning_curves            # 12 million kart-steps, about an hour
    python -m benchmarks.learning_curves --seeds 0 1 --total-timesteps 500000

The same training runs twice for each seed: by default, where the actors drive the next rollout
during an update, and with ``--on-policy``, where they wait for the update. The curves of the mean
time ratio in self-play races are compared per kart-step, over the second half of the training. The
same command resumes an interrupted run.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_common import RESULTS, Table, host_facts, print_tables
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text
from stkzoo.agents.training.common.run_folder import read_log
from stkzoo.agents.training.ppo import selfplay

RUNS = {"overlapping": (), "on-policy": ("--on-policy",)}
#: Compared figures of the log.
FIGURES = ("selfplay_ratio", "selfplay_unfinished")
_OPTIONS = ("--races", "10x8", "--actors", "2", "--anneal-timesteps")
_POINTS = 40


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = CommandParser(prog="python -m benchmarks.learning_curves", description=__doc__)
    words.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], metavar="N")
    words.add_argument("--total-timesteps", type=int, default=2_000_000, metavar="N")
    words.add_argument("--folder", type=Path, default=Path("runs/curves"), help="of the runs")
    output = RESULTS / "learning" / "overlap.json"
    words.add_argument("--output", type=Path, default=output, help="JSON file to write")
    options = words.parse_args(arguments)
    total = str(options.total_timesteps)
    for seed in options.seeds:
        for name, extra in RUNS.items():
            given = ["--output", str(options.folder / f"{name}-{seed}"), "--seed", str(seed)]
            given += ["--total-timesteps", total, *_OPTIONS, total, *extra]
            if code := selfplay.main(given):
                return code
    logs = {
        name: [read_log(options.folder / f"{name}-{seed}") for seed in options.seeds]
        for name in RUNS
    }
    found = {
        "host": host_facts(),
        "kart_steps": options.total_timesteps,
        "runs": {name: _summary(own, options.total_timesteps) for name, own in logs.items()},
    }
    write_text(options.output, json.dumps(found, indent=1) + "\n")
    print_tables([_table(found["runs"])])
    return 0


def _summary(logs: Sequence[Sequence[Mapping[str, Any]]], total: int) -> dict[str, Any]:
    """Returns the mean curve of all seeds, and each seed's mean over the second half."""
    points = np.linspace(total / _POINTS, total, _POINTS)
    curves = {}
    for figure in FIGURES:
        rows = [[line for line in log if figure in line] for log in logs]
        curves[figure] = [
            np.interp(points, [line["kart_steps"] for line in own], [line[figure] for line in own])
            for own in rows
        ]
    return {
        figure: {
            "second_half": [round(float(curve[_POINTS // 2 :].mean()), 5) for curve in own],
            "curve": [round(float(value), 5) for value in np.mean(own, axis=0)],
        }
        for figure, own in curves.items()
    }


def _table(runs: Mapping[str, Mapping[str, Any]]) -> Table:
    rows = []
    for name, own in runs.items():
        halves = [own[figure]["second_half"] for figure in FIGURES]
        cells = (f"{np.mean(half):.3f} ({min(half):.3f}..{max(half):.3f})" for half in halves)
        rows.append((name, *cells))
    title = "second half of the training, mean (lowest..highest seed)"
    return Table(title, ("", *FIGURES), rows)


if __name__ == "__main__":
    sys.exit(main())
