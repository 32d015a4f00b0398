"""Evaluates *random*, *zenith* and the game's AI in the tasks of the suite.

    python -m benchmarks.suite_baselines               # half an hour; continues if interrupted
    python -m benchmarks.suite_baselines --tasks solo-general

Writes ``stkzoo/suite/baselines.json``: the score of each driver in each task, with its interval. In
each task, *random* has the normalized score 0 and *zenith* 1, by definition.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path

from rich.console import Console

from benchmarks.common import parser
from stkzoo._os import write_text
from stkzoo.suite import SUITE, TASKS, evaluate
from stkzoo.suite.population import population_digests
from stkzoo.suite.scores import BASELINES_FILE, ONE, ZERO, load_baselines

#: The ends of the scale of normalized scores, and the game's AI at the difficulty of each race.
DRIVERS = (ZERO, ONE, "ai")


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser("suite_baselines", __doc__)
    words.add_argument("--tasks", nargs="+", choices=TASKS, default=[*TASKS])
    words.add_argument(
        "--folder", type=Path, default=Path("runs/suite-baselines"), help="of the entries"
    )
    words.add_argument("--output", type=Path, default=BASELINES_FILE, help="JSON file to write")
    options = words.parse_args(arguments)
    known_baselines = load_baselines()
    scores = {
        name: {driver: asdict(score) for driver, score in own.items()}
        for name, own in known_baselines.scores.items()
        if name in TASKS and known_baselines.has(name)
    }
    console = Console(stderr=True)
    for task in options.tasks:
        for driver in DRIVERS:
            folder = options.folder / f"{task}-{driver.replace(':', '-')}"
            with console.status(f"{driver} in {task}"):
                entry = evaluate(task, driver, output=folder, plot=False)
            assert entry.score is not None  # noqa: S101 - it has races
            scores.setdefault(task, {})[driver] = asdict(entry.score)
            console.print(f"{task}: {driver} {entry.score.value:.3f}")
            own = {
                "suite": SUITE,
                "digests": {name: TASKS[name].digest for name in scores},
                "population": population_digests(),
                "scores": scores,
            }
            write_text(options.output, json.dumps(own, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
