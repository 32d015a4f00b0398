"""Results of simulated training runs: valid files with random scores."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo._os import write_text
from stkzoo.evaluation import BenchmarkForm, Estimate
from stkzoo.evaluation.benchmark.races import direction_name, make_races
from stkzoo.suite import SUITE, find_task
from stkzoo.suite.report.results import (
    LearningCurve,
    RaceScore,
    SplitScores,
    SuiteRun,
    population_of,
)

#: Function that returns the value of a race from its track, direction and form.
Value = Callable[[str, str, str], float]


def split_scores(task: str, tracks: Sequence[str], seeds: int, value: Value) -> SplitScores:
    """Returns the scores of all races on some tracks."""
    forms = [BenchmarkForm.of(form) for form in find_task(task).forms]
    races = tuple(
        RaceScore(
            race.track,
            direction_name(race.reverse),
            race.form,
            value(race.track, direction_name(race.reverse), race.form),
        )
        for race in make_races(tracks, (False, True), forms, seeds)
    )
    mean = math.fsum(race.value for race in races) / len(races)
    return SplitScores(Estimate(mean, None, None), races)


def suite_run(
    name: str, algorithm: str, seed: int, value: Value | None = None, **changes: Any
) -> SuiteRun:
    """Returns a valid result.

    Args:
        name: name of the task.
        algorithm: name of the algorithm. Longer names have better scores.
        seed: seed of the run and of its random scores.
        value: function for the value of each race; random by default.
        **changes: other values of fields.
    """
    task, random = find_task(name), np.random.default_rng([seed, *algorithm.encode()])
    skill = 0.4 + 0.05 * len(algorithm) + random.normal(0, 0.04)
    steps = np.linspace(8192, 2_000_000, 40).round().astype(int).tolist()

    def drawn(track: str, _: str, __: str) -> float:
        share = min(max(skill + 0.02 * (len(track) - 9) + random.normal(0, 0.1), 0), 1)
        return 1.5 - 0.6 * share if task.metric == "time_ratio" else round(share * 4) / 4

    returns = [None, *(100 * skill * (1 - np.exp(-n / 8)) for n in range(1, 40))]
    values = {
        "suite": SUITE,
        "task": name,
        "task_digest": task.digest,
        "population": population_of(task),
        "algorithm": algorithm,
        "seed": seed,
        "budget": 2_000_000,
        "kart_steps": steps[-1],
        "curve": LearningCurve(
            tuple(steps),
            tuple(step / 1000 for step in steps),
            tuple(None if value is None else float(value) for value in returns),
            (None, *[0.5] * 39),
            (None, *[2.5] * 39),
        ),
        "test": split_scores(name, task.test_tracks, task.seeds, value or drawn),
        "train": split_scores(name, task.train_tracks, 1, value or drawn),
        "training_seconds": 2000.0,
        "evaluation_seconds": 300.0,
        "cores": 2,
        "versions": {"stkzoo": "0.1.0"},
    }
    return SuiteRun(**{**values, **changes})


def write_run(folder: Path, run: SuiteRun) -> Path:
    """Writes a result and returns its file."""
    file = folder / f"{run.name}.json"
    write_text(file, run.to_json() + "\n")
    return file
