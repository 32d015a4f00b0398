"""The content of a report of training runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from stkzoo.evaluation.statistics import Estimate
from stkzoo.race.document import Document
from stkzoo.suite.report.statistics import FloatArray

#: Name of the scale of tasks with baselines.
NORMALIZED = "normalized score"


@dataclass(frozen=True, slots=True)
class Band:
    """A curve with a band.

    Attributes:
        x: the coordinates.
        values: value at each of them.
        low: lower end of the band; ``None`` from a single run.
        high: upper end of the band; ``None`` as for ``low``.
    """

    x: tuple[float, ...]
    values: tuple[float, ...]
    low: tuple[float, ...] | None
    high: tuple[float, ...] | None

    @classmethod
    def of(
        cls, x: FloatArray, values: FloatArray, low: FloatArray | None, high: FloatArray | None
    ) -> Band:
        """Returns the curve of arrays ``(N,)``, rounded to six digits after the point."""
        rounded = [None if a is None else _rounded(a) for a in (low, high)]
        return cls(_rounded(x), _rounded(values), *rounded)


def _rounded(values: FloatArray) -> tuple[float, ...]:
    return tuple(np.round(values, 6).tolist())


@dataclass(frozen=True, slots=True)
class AlgorithmReport:
    """The runs of an algorithm in a task.

    Attributes:
        algorithm: name of the algorithm.
        seeds: seeds of the runs.
        score: mean of the task's metric on the test tracks.
        train_score: mean of the task's metric on the training tracks.
        iqm: interquartile mean of the scores on the test tracks, on the task's scale.
        gap: mean score on the training tracks minus that on the test tracks, on the task's scale.
        profile: share of runs, tracks and directions with a score above each threshold.
        returns: mean return of races during the training, by kart-steps; the band contains all
            runs.
        kart_steps: mean number of kart-steps of a run.
        training_hours: mean duration of a training [h].
        evaluation_hours: mean duration of the evaluations of a run [h].
        cores: numbers of cores of the machines.
    """

    algorithm: str
    seeds: tuple[int, ...]
    score: Estimate
    train_score: Estimate
    iqm: Estimate
    gap: Estimate
    profile: Band
    returns: Band | None
    kart_steps: float
    training_hours: float
    evaluation_hours: float
    cores: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Improvement:
    """A comparison of two algorithms.

    Attributes:
        first: name of the first algorithm.
        second: name of the second algorithm.
        probability: probability that a run of the first is better than one of the second on a
            track and direction.
    """

    first: str
    second: str
    probability: Estimate


@dataclass(frozen=True, slots=True)
class TaskReport:
    """The runs in a task.

    Attributes:
        task: name of the task.
        task_digest: :attr:`Task.digest <stkzoo.suite.Task.digest>`.
        metric: the task's metric.
        scale: ``"normalized score"``, or the metric if the task has no baselines. Higher is better:
            a time ratio has a minus sign on its scale.
        budget: number of kart-steps to learn from.
        algorithms: the algorithms.
        improvements: comparisons of each pair of algorithms.
    """

    task: str
    task_digest: str
    metric: str
    scale: str
    budget: int
    algorithms: tuple[AlgorithmReport, ...]
    improvements: tuple[Improvement, ...]


@dataclass(frozen=True, slots=True)
class SuiteReport(Document):
    """A report of training runs.

    Attributes:
        suite: name of the suite.
        confidence: coverage probability of the intervals.
        draws: number of draws of the bootstraps.
        tasks: the tasks that have runs.
        versions: versions of the software that ran, by name.
    """

    type_name: ClassVar[str] = "suite-report"
    version: ClassVar[int] = 2  # 1: it also had all tasks together, and missing runs
    origin: ClassVar[str] = "the report.json of `stkzoo suite report`"

    suite: str
    confidence: float
    draws: int
    tasks: tuple[TaskReport, ...]
    versions: dict[str, tuple[str, ...]]
