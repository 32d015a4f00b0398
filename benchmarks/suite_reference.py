"""Trains the reference algorithms of the suite, and evaluates their agents.

    python -m benchmarks.suite_reference                   # days; continues if interrupted
    python -m benchmarks.suite_reference --tasks versus --algorithms ippo --seeds 0
    python -m benchmarks.suite_reference --only-evaluate   # runs that are already trained

Each run is trained as with ``stkzoo suite train``, and evaluated on the test tracks and on the
training tracks of its task. Agents run in the process of their race, because their code is ours:
the races are the same as in a sandbox, and faster. A result is written to
``benchmarks/results/suite`` immediately, for ``stkzoo suite report``. All tasks and algorithms of a
seed are run before the next seed. Runs that have a result are skipped.
"""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from rich.console import Console

from benchmarks.common import RESULTS, parser
from stkzoo._os import write_text
from stkzoo._schema import Count, Whole
from stkzoo.agents.training.common.run_folder import ARGUMENTS, read_run_file, require_log
from stkzoo.agents.training.suite import algorithms
from stkzoo.agents.training.suite.algorithms import MACHINE, TrainingMachine
from stkzoo.errors import ConfigError
from stkzoo.suite import (
    ALGORITHMS,
    SUITE,
    TASKS,
    About,
    Entry,
    LearningCurve,
    SplitScores,
    SuiteRun,
    can_learn,
    evaluate,
    find_task,
)
from stkzoo.suite.report.results import population_of

#: Tasks with reference results.
REFERENCE_TASKS = ("solo-general", "versus", "selfplay-5", "team-2v2")
SEEDS = (0, 1, 2)
#: Folder of the results.
OUTPUT = RESULTS / "suite"
#: Folders of the evaluations in the folder of a run, by split.
_EVALUATIONS = {"test": "evaluation-test", "train": "evaluation-train"}
_MAX_POINTS = 100
#: Task, algorithm and seed of a run.
RunKey = tuple[str, str, int]


@dataclass(frozen=True, slots=True)
class _Arguments:
    """The arguments of a run that identify it."""

    task: str
    algorithm: str
    seed: Count
    anneal_timesteps: Whole


@dataclass(frozen=True, slots=True)
class _Chapter:
    """The arguments of a part of a run."""

    arguments: _Arguments


_Chapters: Any = Annotated[tuple[_Chapter, ...], Meta(min_length=1)]


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser("suite_reference", __doc__)
    words.add_argument("--tasks", nargs="+", choices=TASKS, default=REFERENCE_TASKS)
    words.add_argument("--algorithms", nargs="+", choices=ALGORITHMS, default=[*ALGORITHMS])
    words.add_argument("--seeds", nargs="+", type=int, default=SEEDS)
    words.add_argument("--kart-steps", type=int, help="instead of the task's budget")
    words.add_argument("--runs", type=Path, default=Path("runs/suite"), help="folder of the runs")
    words.add_argument("--output", type=Path, default=OUTPUT, help="folder of the results")
    words.add_argument("--jobs", type=int, help="races at the same time (default: all cores)")
    words.add_argument(
        "--only-evaluate", action="store_true", help="skip runs that are not trained"
    )
    options = words.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    console = Console(stderr=True)
    for task, algorithm, seed in reference_keys(options.tasks, options.algorithms, options.seeds):
        name = f"{task}-{algorithm}-{seed}"
        file = options.output / f"{name}.json"
        if file.exists():
            SuiteRun.load(file)  # an outdated result is an error
            console.print(f"{name}: has a result")
            continue
        folder = options.runs / name
        if options.only_evaluate and not (folder / "agent").is_dir():
            console.print(f"{name}: is not trained")
            continue
        if not options.only_evaluate:
            _train(folder, (task, algorithm, seed), options.kart_steps)
        run = measure(folder, (task, algorithm, seed), options.jobs)
        write_text(file, run.to_json() + "\n")
        console.print(f"{name}: {run.test.score.value:.3f}, training {run.train.score.value:.3f}")
    return 0


def reference_keys(
    tasks: Sequence[str] = REFERENCE_TASKS,
    algorithms: Iterable[str] = ALGORITHMS,
    seeds: Sequence[int] = SEEDS,
) -> Iterator[RunKey]:
    """Yields task, algorithm and seed of all runs, in the order in which they are trained.

    Tasks that an algorithm cannot learn are skipped.
    """
    for seed, algorithm, task in itertools.product(seeds, algorithms, tasks):
        if can_learn(algorithm, find_task(task)):
            yield task, algorithm, seed


def _train(folder: Path, key: RunKey, kart_steps: int | None) -> None:
    """Trains or continues a run; does nothing if the run is complete."""
    task, algorithm, seed = key
    budget = find_task(task).budget if kart_steps is None else kart_steps
    algorithms.run(algorithm, folder, task, budget, seed)


def measure(folder: Path, key: RunKey, jobs: int | None = None) -> SuiteRun:
    """Evaluates a trained run; returns its result.

    Args:
        folder: folder of the run.
        key: task, algorithm and seed of the run.
        jobs: number of parallel races; by default, one per core.

    Raises:
        ConfigError: the folder contains another run.
        BatchError: some races could not be run.
    """
    given = read_run_file(_Chapters, folder / ARGUMENTS)[-1].arguments
    found = given.task, given.algorithm, given.seed
    if found != key:
        raise ConfigError(f"{folder} contains the run {found}, expected {key}")
    curve, task = learning_curve(require_log(folder)), find_task(key[0])
    machine = _machine(folder)
    begin = time.perf_counter()
    entries = {split: _evaluate(folder, key, split, curve, jobs) for split in _EVALUATIONS}
    return SuiteRun(
        suite=SUITE,
        task=task.name,
        task_digest=task.digest,
        population=population_of(task),
        algorithm=key[1],
        seed=key[2],
        budget=given.anneal_timesteps,
        kart_steps=curve.kart_steps[-1],
        curve=curve,
        test=SplitScores.of(entries["test"]),
        train=SplitScores.of(entries["train"]),
        training_seconds=curve.seconds[-1],
        evaluation_seconds=round(time.perf_counter() - begin, 1),
        cores=machine.cores,
        versions=machine.versions,
    )


def _machine(folder: Path) -> TrainingMachine:
    """Returns the machine that trained a run; this one for runs from earlier versions."""
    file = folder / MACHINE
    return read_run_file(TrainingMachine, file) if file.exists() else TrainingMachine.now()


def _evaluate(
    folder: Path, key: RunKey, split: str, curve: LearningCurve, jobs: int | None
) -> Entry:
    task, algorithm, seed = key
    about = About(
        description=f"{algorithm} of stkzoo, seed {seed}", kart_steps=curve.kart_steps[-1]
    )
    output, agent = folder / _EVALUATIONS[split], str(folder / "agent")
    with Console(stderr=True).status(f"{task} {algorithm} {seed}: {split} tracks"):
        return evaluate(
            task, agent, split=split, output=output, about=about, jobs=jobs, plot=False, inline=True
        )


def learning_curve(log: Sequence[Mapping[str, Any]]) -> LearningCurve:
    """Returns the curve of a run with at most 100 points, the last one included.

    Args:
        log: lines of the run's log.
    """
    steps = [line["kart_steps"] for line in log]
    lengths = np.diff(steps, prepend=0) / [line["kart_steps_per_s"] for line in log]
    seconds = np.cumsum(lengths).round(3).tolist()
    chosen = thinned(len(log))

    def figures(name: str) -> tuple[float | None, ...]:
        return tuple(log[n].get(name) for n in chosen)

    return LearningCurve(
        tuple(steps[n] for n in chosen),
        tuple(seconds[n] for n in chosen),
        figures("return"),
        figures("finished"),
        figures("position"),
    )


def thinned(count: int) -> list[int]:
    """Returns the numbers of the points of a long curve to keep, with the first and the last.

    Args:
        count: number of points.
    """
    chosen: list[int] = (
        np.linspace(0, count - 1, min(count, _MAX_POINTS)).round().astype(int).tolist()
    )
    return chosen


if __name__ == "__main__":
    sys.exit(main())
