"""Training runs, read from their entries: the folders of entries and the log of the training."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from stkzoo._reading import read_lines, reading
from stkzoo._schema import Count, Seconds, Share, plain_name
from stkzoo.errors import ConfigError
from stkzoo.race.result import RaceResult
from stkzoo.suite.about import LEARNED, TRAINING_LOG
from stkzoo.suite.entry import ENTRY_FILE, Entry
from stkzoo.suite.population import POPULATION
from stkzoo.suite.report.statistics import FloatArray
from stkzoo.suite.tasks import Task
from stkzoo.suite.verification import check_recordings

#: ``reverse`` in the columns of a track, in their order.
DIRECTIONS = (False, True)
#: Names of the scores against rivals that are allowed in training, and against those held out.
SEEN, HELD_OUT = "seen rivals", "held-out rivals"
_ORIGIN = "the folder of an entry from `stkzoo suite evaluate`, or one with such folders"
_HELD_OUT = {member.driver for member in POPULATION if member.is_held_out}
_MAX_POINTS = 100
_MAX_NAME = 40  # maximum length of a name [characters]
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
        if any(before >= after for before, after in itertools.pairwise(self.kart_steps)):
            raise ConfigError("its kart-steps do not increase")

    @classmethod
    def load(cls, file: Path) -> LearningCurve:
        """Returns the curve of a training log with at most 100 points, the last one included.

        Args:
            file: the log, with ``kart_steps`` and ``kart_steps_per_s`` in each line.

        Raises:
            ConfigError: the file is not such a log.
        """
        with reading(f"{file} is not the log of a training", "the file that the training wrote"):
            log = read_lines(file, dict[str, Any])
            steps = [line["kart_steps"] for line in log]
            lengths = np.diff(steps, prepend=0) / [line["kart_steps_per_s"] for line in log]
            shown = np.linspace(0, len(log) - 1, min(len(log), _MAX_POINTS)).round().astype(int)
            columns = (
                [steps[n] for n in shown],
                np.cumsum(lengths).round(3)[shown].tolist(),
                *([log[n].get(name) for n in shown] for name in ("return", "finished", "position")),
            )
            names = (entry.name for entry in fields(cls))
            return msgspec.convert(dict(zip(names, columns, strict=True)), cls)


@dataclass(frozen=True, slots=True)
class Evaluation:
    """An entry, or an evaluation on the training tracks, and its recorded races.

    Attributes:
        folder: its folder.
        entry: its content.
        results: result of each race, from its replay.
    """

    folder: Path
    entry: Entry
    results: tuple[RaceResult, ...]

    @classmethod
    def load(cls, folder: Path) -> Evaluation:
        """Returns an evaluation whose numbers follow from its replays.

        Args:
            folder: its folder.

        Raises:
            StkzooError: it is incomplete, or a replay or a number is not that of the entry.
        """
        entry = Entry.load(folder / ENTRY_FILE)
        return cls(folder, entry, check_recordings(entry, folder))

    @property
    def key(self) -> tuple[str, str, int | None, str]:
        """Task, algorithm, seed of the training and variant; the same for both splits."""
        about = self.entry.plan.about
        names = (about.algorithm or self.entry.label, about.variant)
        name, variant = (plain_name(text, _MAX_NAME).replace("|", "/") for text in names)
        return self.entry.plan.task, name, about.training_seed, variant

    def values(self, **facts: object) -> list[float]:
        """Returns the task's metric of races.

        Args:
            **facts: values that choose the races, by field, such as ``form="PBBBB"``.
        """
        metric = self.entry.task.metric
        return [
            getattr(race, metric)
            for race in self.entry.races
            if all(getattr(race, name) == value for name, value in facts.items())
        ]

    def by_column(self) -> FloatArray:
        """Returns the mean over the races of each track and direction, ``(C,)``.

        The columns of a track are neighbors, in the order of :data:`DIRECTIONS`.
        """
        columns = itertools.product(self.entry.plan.tracks, DIRECTIONS)
        return np.array([fmean(self.values(track=t, reverse=way)) for t, way in columns])

    def parts(self) -> dict[str, float]:
        """Returns the mean of the metric in each race form, and the share of rivals beaten.

        The latter is separate for rivals of the population that are allowed in training, and for
        those that are held out.
        """
        forms = self.entry.plan.forms
        means = {form: fmean(self.values(form=form)) for form in forms}
        beaten: dict[str, list[float]] = {SEEN: [], HELD_OUT: []}
        for race, result in zip(self.entry.races, self.results, strict=True):
            if race.lineup.has_population:
                karts = race.lineup.agent_karts(race.end)
                for source, share in _beaten(result, karts).items():
                    beaten[HELD_OUT if source in _HELD_OUT else SEEN].append(share)
        return means | {name: fmean(shares) for name, shares in beaten.items() if shares}


def _beaten(result: RaceResult, karts: Sequence[int]) -> dict[str, float]:
    """Returns the share of an agent's karts that finished ahead of each rival, by its source."""
    rows = {row.start_position - 1: row for row in result.agents}
    ranks = [rows[kart].rank if rows[kart].finish_time is not None else len(rows) for kart in karts]
    rivals = (row for place, row in rows.items() if place not in karts)
    return {row.source: fmean(rank < row.rank for rank in ranks) for row in rivals}


@dataclass(frozen=True, slots=True)
class SuiteRun:
    """A training run in a task, or a driver without one.

    Attributes:
        test: its entry.
        train: its evaluation on the training tracks; ``None`` without one.
        curve: its learning curve; ``None`` without a log.
    """

    test: Evaluation
    train: Evaluation | None
    curve: LearningCurve | None

    @property
    def task(self) -> Task:
        """The task."""
        return self.test.entry.task

    @property
    def seed(self) -> int | None:
        """Seed of the training; ``None`` if unknown."""
        return self.test.key[2]

    @property
    def agent_class(self) -> str:
        """Class of the agent."""
        return str(self.test.entry.plan.about.agent_class)

    @property
    def name(self) -> tuple[str, str]:
        """Name of the algorithm, and variant of the evaluation."""
        return self.test.key[1], self.test.key[3]

    @property
    def kart_steps(self) -> int | None:
        """Number of kart-steps learned from, as the entry or the log says; ``None`` if unknown."""
        said = self.test.entry.plan.about.kart_steps
        return self.curve.kart_steps[-1] if said is None and self.curve else said


def load_runs(
    paths: Iterable[str | os.PathLike[str]], load: Callable[[Path], Evaluation] = Evaluation.load
) -> tuple[SuiteRun, ...]:
    """Reads training runs from the folders of their entries.

    Entries with the same task, algorithm, seed of the training and variant are of one run. The log
    of the training is ``log.jsonl`` beside the folder of the entry.

    Args:
        paths: folders of entries, and folders that contain them.
        load: reads the folder of an entry.

    Returns:
        The runs, ordered by task, class, algorithm, variant and seed.

    Raises:
        ConfigError: there is no entry, a file is damaged, an evaluation occurs twice or has no
            entry, or runs of a task have different races or budgets.
        EntryRefused: an entry is incomplete, or a replay or a number is not that of the entry.
    """
    by_split: dict[bool, dict[Any, Evaluation]] = {False: {}, True: {}}
    owners: dict[tuple[str, ...], Path] = {}
    for folder in _entry_folders(paths):
        evaluation = load(folder)
        if (owner := owners.setdefault(evaluation.entry.replays, folder)) != folder:
            raise ConfigError(f"{owner} and {folder} have the same replays; leave one out")
        of_split = by_split[evaluation.entry.plan.is_on_training_tracks]
        other = of_split.setdefault(evaluation.key, evaluation)
        if other is not evaluation:
            raise ConfigError(
                f"{other.folder} and {folder} are of the same run, {_text(evaluation.key)}; leave "
                "one out, or evaluate it with another --training-seed or --variant"
            )
    tests, trains = by_split[False], by_split[True]
    for key in trains.keys() - tests.keys():
        raise ConfigError(
            f"{trains[key].folder} has the training tracks of {_text(key)}, and its entry is "
            "missing; evaluate the agent also without --split train"
        )
    runs = [SuiteRun(test, trains.get(key), _curve(test)) for key, test in tests.items()]
    _check_races(runs)
    for task in {run.task for run in runs}:
        _check_budgets([run for run in runs if run.task == task])
    return tuple(sorted(runs, key=_order))


def _entry_folders(paths: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """Returns the folders of all entries in some folders, each once."""
    folders: dict[str, Path] = {}
    for path in map(Path, paths):
        places = sorted(file.parent for file in path.rglob(ENTRY_FILE))
        if not places:
            raise ConfigError(f"{path} has no entry ({ENTRY_FILE}, replays); expected {_ORIGIN}")
        folders |= {os.path.realpath(place): place for place in places}
    return [*folders.values()]


def _curve(test: Evaluation) -> LearningCurve | None:
    """Returns the learning curve of the run that trained the agent of an entry, if it has a log."""
    log, said = test.folder.parent / TRAINING_LOG, test.entry.plan.about.kart_steps
    if not log.is_file():
        return None
    curve = LearningCurve.load(log)
    if said not in (None, curve.kart_steps[-1]):
        raise ConfigError(
            f"{test.folder} is of an agent with {said} kart-steps, and {log} ends at "
            f"{curve.kart_steps[-1]}; keep entries in the run that trained their agent"
        )
    return curve


def _check_races(runs: Sequence[SuiteRun]) -> None:
    """Checks that all runs had the races of their task, or fresh ones from the same text."""
    by_text = {run.test.entry.plan.fresh: run.test.folder for run in runs}
    if len(by_text) > 1:
        races = " and ".join(
            (f"fresh ones from {text!r}" if text else "those of the task") + f" ({folder})"
            for text, folder in sorted(by_text.items())
        )
        raise ConfigError(f"the races of runs are {races}; write a report for each")


def _check_budgets(runs: Sequence[SuiteRun]) -> None:
    """Checks that the learned agents of a task learned from equally many kart-steps."""
    steps = {
        run.kart_steps: run.test.folder
        for run in runs
        if run.kart_steps is not None and run.agent_class == LEARNED
    }
    if steps and (most := max(steps)) - (least := min(steps)) > _MAX_ITERATION:
        raise ConfigError(
            f"runs learned from {least:,} ({steps[least]}) and {most:,} ({steps[most]}) "
            "kart-steps; write a report for each budget"
        )


def _text(key: tuple[str, str, int | None, str]) -> str:
    return ", ".join(str(part) for part in key if part not in (None, ""))


def _order(run: SuiteRun) -> tuple[Any, ...]:
    task, algorithm, seed, variant = run.test.key
    return task, run.agent_class, algorithm, variant, -1 if seed is None else seed
