"""Chooses view, action and hyperparameters of the suite's algorithms on the validation tracks.

    python -m benchmarks.suite_pilot                     # hours; continues if interrupted
    python -m benchmarks.suite_pilot --only "final" "gamma*" --task versus

Trains independent PPO (``ippo``) with each candidate's arguments, with the same seed and budget,
and evaluates its agent in races against four of the game's hardest AI (``PAAAA``) on the validation
tracks: once with sampled choices and once with the most likely ones. Drivers that come with stkzoo
race there too. The JSON file has the share of karts beaten, the time ratio and the share of
unfinished races. No candidate is evaluated on the test tracks.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.common import RESULTS, host_facts, parser
from stkzoo._os import write_text
from stkzoo.agents.training.evaluate import newest_policy
from stkzoo.agents.training.export import export_policy
from stkzoo.agents.training.suite import algorithms
from stkzoo.evaluation import run_benchmark
from stkzoo.suite import TASKS

#: Arguments of each candidate that differ from those of the reference runs.
CANDIDATES: Mapping[str, Mapping[str, Any]] = {
    "final": {},
    "gamma 0.98": {"gamma": 0.98},
    "lambda 0.95": {"gae_lambda": 0.95},
    "entropy 0.003": {"ent_coef": 0.003},
    "batches of 2048": {"batch_size": 2048},
    "all races from the grid": {"random_starts": 0.0},
    "drifts of any length": {"hold": 0},
}
#: Drivers for comparison.
DRIVERS = ("random", "ai", "pretrained:regular", "pretrained:zenith")


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser("suite_pilot", __doc__)
    words.add_argument("--only", nargs="+", default=["*"], metavar="NAME", help="candidates")
    words.add_argument("--task", choices=TASKS, default="selfplay-5")
    words.add_argument("--kart-steps", type=int, default=2_000_000)
    words.add_argument("--seed", type=int, default=0)
    words.add_argument("--folder", type=Path, default=Path("runs/pilot"), help="folder of the runs")
    words.add_argument("--output", type=Path, default=RESULTS / "suite" / "pilot.json")
    options = words.parse_args(arguments)
    console = Console(stderr=True)
    rows: dict[str, Any] = {}
    for name in (*DRIVERS, *CANDIDATES):
        if not any(fnmatch(name, shape) for shape in options.only):
            continue
        folder = options.folder / f"{options.task}-{name.replace(' ', '-').replace(':', '-')}"
        agents = {"driver": name}
        if name in CANDIDATES:
            changes, run = CANDIDATES[name], (options.task, options.kart_steps, options.seed)
            algorithms.run("ippo", folder, *run, **changes)
            policy = newest_policy(str(folder))
            agents = {"sampled": str(folder / "agent"), "argmax": str(folder / "agent-argmax")}
            export_policy(policy, "argmax", agents["argmax"])
        figures = {
            kind: _figures(agent, folder / f"benchmark-{kind}") for kind, agent in agents.items()
        }
        rows[name] = {"changes": dict(CANDIDATES.get(name, {})), **figures}
        console.print(f"{name}: {figures}")
        facts = {name: getattr(options, name) for name in ("task", "kart_steps", "seed")}
        options.output.parent.mkdir(parents=True, exist_ok=True)
        content = {"host": host_facts(), **facts, "candidates": rows}
        write_text(options.output, json.dumps(content, indent=1) + "\n")
    return 0


def _figures(agent: str, output: Path) -> dict[str, float]:
    """Returns the mean figures of an agent in races on the validation tracks."""
    result = run_benchmark(
        agent, split="validation", forms=("PAAAA",), seeds=1, output=output, plot=False
    )
    figures = result.group().figures
    beaten = float(np.mean([race.beaten for race in result.races]))
    means = {name: figures[name].value for name in ("time_ratio", "unfinished")}
    return {name: round(value, 3) for name, value in {"beaten": beaten, **means}.items()}


if __name__ == "__main__":
    sys.exit(main())
