"""The content of a report of training runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from stkzoo.evaluation.statistics import Estimate
from stkzoo.race.document import Document

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


@dataclass(frozen=True, slots=True)
class AlgorithmReport:
    """The runs of an algorithm in a task.

    Attributes:
        algorithm: name of the algorithm; that of the agent without one.
        variant: variant of the evaluation; may be empty.
        agent_class: class of its agents: ``"learned"``, ``"scripted"`` or ``"search"``.
        runs: number of runs.
        seeds: known seeds of the runs.
        over_runs: mean of the task's metric on the test tracks, with an interval over runs on the
            same tracks (Student's t).
        over_tracks: the same with an interval over tracks for the mean of these runs (Student's t).
        iqm: interquartile mean of the scores on the test tracks, on the task's scale.
        train_score: mean of the metric on the training tracks, with an interval over runs; ``None``
            if a run has no evaluation there.
        gap: mean score on the training tracks minus that on the test tracks, on the task's scale;
            ``None`` as for ``train_score``.
        parts: mean of the metric in each race form, and share of seen and held-out rivals beaten,
            with intervals over runs.
        returns: mean return of races during the training, by kart-steps; the band contains all
            runs. ``None`` without logs.
        said: what the entries say about class, demonstrations and pretraining.
        kart_steps: mean number of kart-steps of a run; ``None`` if unknown.
        training_hours: mean duration of a training [h]; ``None`` without logs.
    """

    algorithm: str
    variant: str
    agent_class: str
    runs: int
    seeds: tuple[int, ...]
    over_runs: Estimate
    over_tracks: Estimate
    iqm: Estimate
    train_score: Estimate | None
    gap: Estimate | None
    parts: Mapping[str, Estimate]
    returns: Band | None
    said: tuple[str, ...]
    kart_steps: float | None
    training_hours: float | None

    @property
    def name(self) -> str:
        """Name of the algorithm with the variant."""
        return f"{self.algorithm} ({self.variant})" if self.variant else self.algorithm


@dataclass(frozen=True, slots=True)
class Improvement:
    """A comparison of two algorithms of the same class.

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
class PowerReport:
    """How many runs a comparison of two learned algorithms needs.

    Attributes:
        deviation: standard deviation of the metric's mean between runs of an algorithm, pooled over
            all algorithms with several runs.
        freedom: its degrees of freedom.
        runs: number of runs of each algorithm that detect a difference with 80% power at 5%, by
            difference.
    """

    deviation: float
    freedom: int
    runs: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class TaskReport:
    """The runs in a task.

    Attributes:
        task: name of the task.
        task_digest: :attr:`Task.digest <stkzoo.suite.Task.digest>`.
        fresh: text from which the seeds of the races are drawn; empty for those of the task.
        metric: the task's metric.
        scale: ``"normalized score"``, or the metric if the ends of the scale are unknown. Higher is
            better: a time ratio has a minus sign on its scale.
        algorithms: the algorithms, by class.
        improvements: comparisons of each pair of algorithms of the same class.
        power: how many runs a comparison needs; ``None`` if no algorithm has different runs.
    """

    task: str
    task_digest: str
    fresh: str
    metric: str
    scale: str
    algorithms: tuple[AlgorithmReport, ...]
    improvements: tuple[Improvement, ...]
    power: PowerReport | None


@dataclass(frozen=True, slots=True)
class SuiteReport(Document):
    """A report of training runs.

    Attributes:
        suite: name of the suite.
        confidence: coverage probability of the intervals.
        draws: number of draws of the bootstraps.
        tasks: the tasks that have runs.
        versions: versions of the software that ran the evaluations, by name.
    """

    type_name: ClassVar[str] = "suite-report"
    version: ClassVar[int] = 3  # 2: it was of result files, with profiles and without classes
    origin: ClassVar[str] = "the report.json of `stkzoo suite report`"

    suite: str
    confidence: float
    draws: int
    tasks: tuple[TaskReport, ...]
    versions: Mapping[str, tuple[str, ...]]
