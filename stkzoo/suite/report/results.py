"""Result files of training runs: the learning curve, and scores on test and training tracks."""

from __future__ import annotations

import itertools
import json
import math
import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from stkzoo._checks import shortened
from stkzoo._schema import Count, Seconds, Share, Whole, matching
from stkzoo.errors import ConfigError
from stkzoo.evaluation.benchmark.plan import LIMIT
from stkzoo.evaluation.benchmark.races import BenchmarkForm, direction_name, make_races
from stkzoo.evaluation.statistics import Estimate
from stkzoo.race.document import Document
from stkzoo.suite.entry import TEST, TRAIN, Entry
from stkzoo.suite.population import population_digests
from stkzoo.suite.report.statistics import FloatArray
from stkzoo.suite.tasks import SUITE, TIME_RATIO, Task, find_task

_Algorithm = Annotated[str, matching(r"[\w.+-]{1,40}")]
_Digest = Annotated[str, matching("[0-9a-f]{64}")]
_TOLERANCE = 1e-9
#: ``reverse`` in the columns of a track, in their order.
DIRECTIONS = (False, True)
#: Maximum number of kart-steps of an iteration. A run ends with the one that uses up its budget.
_MAX_ITERATION = 100_000


@dataclass(frozen=True, slots=True)
class LearningCurve:
    """Figures of a training run; lists of the same length, one entry per point.

    Attributes:
        kart_steps: number of kart-steps so far.
        seconds: training time so far [s].
        returns: mean return of the latest races; ``None`` before the first one has ended.
        finished: share of karts that finished these races.
        position: mean position at their end.
    """

    kart_steps: Annotated[tuple[Count, ...], Meta(min_length=1)]
    seconds: tuple[Seconds, ...]
    returns: tuple[float | None, ...]
    finished: tuple[Share | None, ...]
    position: tuple[Annotated[float, Meta(ge=1)] | None, ...]

    def __post_init__(self) -> None:
        lengths = {entry.name: len(getattr(self, entry.name)) for entry in fields(self)}
        if len(set(lengths.values())) > 1:
            raise ConfigError(f"the lists of the curve have different lengths: {lengths}")
        steps = self.kart_steps
        if any(before >= after for before, after in itertools.pairwise(steps)):
            raise ConfigError("the kart-steps of the curve do not increase")


@dataclass(frozen=True, slots=True)
class RaceScore:
    """The metric of one race.

    Attributes:
        track: name of the track.
        direction: ``"forward"`` or ``"reversed"``.
        form: race form.
        value: the task's metric.
    """

    track: str
    direction: str
    form: str
    value: Annotated[float, Meta(ge=0)]


@dataclass(frozen=True, slots=True)
class SplitScores:
    """The scores of an agent on the tracks of a split.

    Attributes:
        score: mean of the task's metric over the races, with its interval over races.
        races: the races.
    """

    score: Estimate
    races: tuple[RaceScore, ...]

    @classmethod
    def of(cls, entry: Entry) -> SplitScores:
        """Returns the scores of a complete evaluation.

        Args:
            entry: the evaluation.

        Raises:
            ConfigError: the evaluation has no races.
        """
        if entry.score is None:
            raise ConfigError(f"the evaluation of {entry.label} has no races")
        metric = entry.task.metric
        return cls(
            entry.score,
            tuple(
                RaceScore(r.track, direction_name(r.reverse), r.form, getattr(r, metric))
                for r in entry.races
            ),
        )

    def by_column(self, tracks: Sequence[str]) -> FloatArray:
        """Returns the mean over the races of each track and direction, ``(C,)``.

        The columns of a track are neighbors, in the order of :data:`DIRECTIONS`.

        Args:
            tracks: the tracks; all have races in both directions.
        """
        values: dict[tuple[str, str], list[float]] = {}
        for race in self.races:
            values.setdefault((race.track, race.direction), []).append(race.value)
        names = [(track, direction_name(way)) for track in tracks for way in DIRECTIONS]
        return np.array([math.fsum(values[name]) / len(values[name]) for name in names])


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteRun(Document):
    """The result of a training run in a task of the suite.

    Attributes:
        suite: name of the suite.
        task: name of the task.
        task_digest: :attr:`Task.digest <stkzoo.suite.Task.digest>`.
        population: digests of the population's drivers, by name; empty if the task has no races
            against them.
        algorithm: name of the algorithm.
        seed: seed of the run.
        budget: number of kart-steps to learn from.
        kart_steps: number of kart-steps learned from, which ends with a whole iteration: at least
            the budget, and at most 100,000 more.
        curve: the learning curve.
        test: scores on the test tracks.
        train: scores on the training tracks.
        training_seconds: time of the training [s], excluding time lost to interruptions.
        evaluation_seconds: time of both evaluations [s]; less if they were interrupted.
        cores: number of cores of the machine that trained.
        versions: versions of the software that trained, by name.
    """

    type_name: ClassVar[str] = "suite-run"
    origin: ClassVar[str] = "a file that `python -m benchmarks.suite_reference` wrote"

    suite: str
    task: str
    task_digest: _Digest
    population: Mapping[str, str]
    algorithm: _Algorithm
    seed: Count
    budget: Whole
    kart_steps: Whole
    curve: LearningCurve
    test: SplitScores
    train: SplitScores
    training_seconds: Seconds
    evaluation_seconds: Seconds
    cores: Whole
    versions: Mapping[str, str]

    def __post_init__(self) -> None:
        if self.suite != SUITE:
            raise ConfigError(f"the suite is {shortened(self.suite)}, expected {SUITE}")
        task = find_task(self.task)
        if self.task_digest != task.digest:
            raise ConfigError(f"it is of another definition of {task.name}; run it again")
        if self.population != population_of(task):
            raise ConfigError(f"it is of another population of {task.name}; evaluate it again")
        self._check_kart_steps()
        for split, scores in ((TEST, self.test), (TRAIN, self.train)):
            _check_scores(task, split, scores)

    def _check_kart_steps(self) -> None:
        if self.kart_steps != self.curve.kart_steps[-1]:
            raise ConfigError(
                f"kart_steps is {self.kart_steps:,}, and the curve ends at "
                f"{self.curve.kart_steps[-1]:,}; expected the same"
            )
        most = self.budget + _MAX_ITERATION
        if not self.budget <= self.kart_steps <= most:
            raise ConfigError(
                f"kart_steps is {self.kart_steps:,}, expected {self.budget:,} (the budget) to "
                f"{most:,}; end the training with the iteration that spends the budget"
            )

    @property
    def name(self) -> str:
        """Name of the run and of its file, without the suffix."""
        return f"{self.task}-{self.algorithm}-{self.seed}"

    def to_json(self) -> str:
        """Returns the result as JSON text with one field per line."""
        values = {"type": self.type_name, "schema_version": self.version, **self.to_dict()}
        lines = (f"{json.dumps(name)}: {_compact(value)}" for name, value in values.items())
        return "{\n" + ",\n".join(lines) + "\n}"


def _compact(value: Any) -> str:
    return json.dumps(value, allow_nan=False, separators=(",", ":"))


def population_of(task: Task) -> dict[str, str]:
    """Returns the digests of the drivers that an evaluation in a task races against.

    Args:
        task: the task.
    """
    return population_digests() if task.has_population else {}


def _check_scores(task: Task, split: str, scores: SplitScores) -> None:
    """Checks that scores are of exactly the races of a split, and follow from them."""
    is_test = split == TEST
    tracks, seeds = (task.test_tracks, task.seeds) if is_test else (task.train_tracks, 1)
    forms = [BenchmarkForm.of(form) for form in task.forms]
    planned = make_races(tracks, DIRECTIONS, forms, seeds)
    expected = Counter((race.track, direction_name(race.reverse), race.form) for race in planned)
    driven = Counter((race.track, race.direction, race.form) for race in scores.races)
    if wrong := sorted({*(expected - driven), *(driven - expected)}):
        name = " ".join(wrong[0])
        raise ConfigError(
            f"{split} has {driven[wrong[0]]} races of {name}, expected {expected[wrong[0]]}"
        )
    values = [race.value for race in scores.races]
    most = LIMIT if task.metric == TIME_RATIO else 1.0
    if max(values) > most:
        raise ConfigError(
            f"{split} has a race with {task.metric} {max(values):g}, expected <= {most:g}"
        )
    mean = math.fsum(values) / len(values)
    if not math.isclose(mean, scores.score.value, abs_tol=_TOLERANCE):
        raise ConfigError(f"{split} has the score {scores.score.value:g}; its races give {mean:g}")


def load_runs(paths: Iterable[str | os.PathLike[str]]) -> tuple[SuiteRun, ...]:
    """Reads result files.

    Args:
        paths: files, and folders whose ``.json`` files are read.

    Returns:
        The runs, ordered by task, algorithm and seed.

    Raises:
        ConfigError: there is no result, a file is damaged or of another definition, a run occurs
            twice, or the runs of a task have different budgets.
    """
    files: list[Path] = []
    for path in map(Path, paths):
        in_path = sorted(path.glob("*.json")) if path.is_dir() else [path]
        if not in_path:
            raise ConfigError(f"{path} has no results; expected {SuiteRun.origin}")
        files += in_path
    runs: dict[str, tuple[SuiteRun, Path]] = {}
    budgets: dict[str, tuple[int, Path]] = {}
    for file in files:
        run = SuiteRun.load(file)
        if run.name in runs:
            raise ConfigError(f"{runs[run.name][1]} and {file} are the same run, {run.name}")
        runs[run.name] = run, file
        budget, other = budgets.setdefault(run.task, (run.budget, file))
        if budget != run.budget:
            raise ConfigError(
                f"{other} has a budget of {budget:,} kart-steps and {file} one of {run.budget:,}; "
                "write a report for each budget"
            )
    return tuple(sorted((run for run, _ in runs.values()), key=_order))


def _order(run: SuiteRun) -> tuple[str, str, int]:
    return run.task, run.algorithm, run.seed
