"""Entries: the recorded races of an agent in a task of the suite, and its scores."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from stkzoo._checks import check_name, shortened
from stkzoo._os import file_digest
from stkzoo._schema import matching
from stkzoo.drivers.driver import GAME_AI, find_driver
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.order import RaceOrder, replay_file
from stkzoo.evaluation.batch.run import BatchKind, RaceResults, RunOptions, written
from stkzoo.evaluation.benchmark.plan import BenchmarkPlan, plan_benchmark
from stkzoo.evaluation.benchmark.races import BenchmarkRace, FigureKind, race_seed
from stkzoo.evaluation.benchmark.result import BenchmarkResult, plot_benchmark, race_outcomes
from stkzoo.evaluation.statistics import Estimate
from stkzoo.race.replay import ReplayWriter
from stkzoo.race.result import RaceResult, shared_protections
from stkzoo.race.settings import RaceSettings
from stkzoo.suite.about import About
from stkzoo.suite.population import draw_rivals, population_digests
from stkzoo.suite.scores import normalized
from stkzoo.suite.tasks import BEATEN, DIFFICULTY, Task, find_task

#: Name of the file with the scores in the folder of an entry.
ENTRY_FILE = "entry.json"
#: Splits of a task's tracks. Only an evaluation on the test tracks is an entry.
TEST, TRAIN = "test", "train"
_BEATEN = FigureKind(BEATEN, lambda race: race.beaten, (0.0, 1.0))
_Digest = Annotated[str, matching("[0-9a-f]{64}")]
_MAX_FRESH = 200  # maximum length of the text for other seeds [characters]


@dataclass(frozen=True, slots=True)
class EntryOrder(RaceOrder):
    """A race of an entry, which stores its replay."""

    def run(self, folder: Path) -> RaceResult:
        """Runs the race in a worker process, and stores its replay.

        Args:
            folder: folder of the entry.
        """
        replay = replay_file(folder, self.number)
        replay.parent.mkdir(exist_ok=True)
        return self.race(self.drivers, [ReplayWriter(replay)])


@dataclass(frozen=True, slots=True, kw_only=True)
class EntryPlan(BenchmarkPlan):
    """The plan of an entry. It determines the races.

    Attributes:
        task: name of the task.
        task_digest: :attr:`Task.digest <stkzoo.suite.Task.digest>`.
        population: digests of the population's drivers, by name.
        about: what the entry says about its agent.
        fresh: text from which the seeds of the races are drawn; empty for those of the task.

    Raises:
        ConfigError: a value is invalid, or contradicts another one.
    """

    type_name: ClassVar[str] = "suite-plan"
    noun: ClassVar[str] = "entry"
    resume_command: ClassVar[str] = "stkzoo suite evaluate TASK AGENT --output {folder}"
    decided: ClassVar[tuple[str, ...]] = (*BenchmarkPlan.decided, "max_paths", "adapter", "teams")
    changeable: ClassVar[tuple[str, ...]] = (*BenchmarkPlan.changeable, "about")
    has_population: ClassVar[bool] = True

    task: str
    task_digest: _Digest
    population: Mapping[str, str]
    about: About = field(default_factory=About)
    fresh: Annotated[str, Meta(max_length=_MAX_FRESH)] = ""

    def __post_init__(self) -> None:
        BenchmarkPlan.__post_init__(self)
        self.about.check(self.agent.source, self.agent.label)
        is_text = isinstance(self.fresh, str) and self.fresh.isprintable()
        if not is_text or len(self.fresh) > _MAX_FRESH:
            raise ConfigError(
                f"fresh is {shortened(self.fresh)}, expected one line of at most {_MAX_FRESH} "
                "letters, digits, signs and spaces"
            )
        if self.fresh and self.is_on_training_tracks:
            raise ConfigError(
                "fresh races are for leaderboards, on the test tracks; leave out fresh (--fresh) "
                "or the split (--split)"
            )

    def races(self) -> tuple[BenchmarkRace, ...]:
        """Returns all races."""
        races = BenchmarkPlan.races(self)
        return tuple(map(self._freshened, races)) if self.fresh else races

    def orders(self) -> list[RaceOrder]:
        """Returns the orders of all races."""
        rivals = draw_rivals(self.races())
        return [_order(order, rivals.get(order.number, ())) for order in BenchmarkPlan.orders(self)]

    def _freshened(self, race: BenchmarkRace) -> BenchmarkRace:
        """Returns a race with a seed from the text for other seeds."""
        text = f"{self.fresh}/{race.track}"
        return replace(race, seed=race_seed(text, race.reverse, race.form, race.end, race.index))

    @property
    def is_on_training_tracks(self) -> bool:
        """Whether this is an evaluation on the training tracks, which is not an entry."""
        return self.split == TRAIN


def _order(order: RaceOrder, rivals: tuple[str, ...]) -> EntryOrder:
    """Returns the order of a race with drivers of the population in place of the game's AI."""
    others = iter(rivals)
    drivers = tuple(next(others, "ai") if text == "ai" else text for text in order.drivers)
    level = next((GAME_AI[text] for text in drivers if GAME_AI.get(text) is not None), None)
    settings = order.settings if level is None else replace(order.settings, difficulty=level)
    return EntryOrder(order.number, drivers, settings, order.wait_for)


def replay_digest(folder: Path, number: int) -> str:
    """Returns the SHA-256 of a replay in the folder of an entry.

    Raises:
        ConfigError: the replay cannot be read.
    """
    file = replay_file(folder, number)
    try:
        return file_digest(file)
    except OSError as error:
        raise ConfigError(
            f"{file} cannot be read; delete the result of the race, races/{file.stem}.json, to "
            "run it again"
        ) from error


@dataclass(frozen=True)
class Entry(BenchmarkResult):
    """The recorded races of an agent in a task, and its scores.

    Attributes:
        plan: the races.
        races: the races that have been run.
        sandboxes: as in :class:`~stkzoo.evaluation.BenchmarkResult`.
        protections: as in :class:`~stkzoo.evaluation.BenchmarkResult`.
        replays: SHA-256 of the replays of these races.
    """

    type_name: ClassVar[str] = "suite-entry"
    origin: ClassVar[str] = f"the {ENTRY_FILE} of `stkzoo suite evaluate`"
    metrics: ClassVar[tuple[FigureKind, ...]] = (*BenchmarkResult.metrics, _BEATEN)

    plan: EntryPlan
    replays: tuple[_Digest, ...] = ()

    def __post_init__(self) -> None:
        BenchmarkResult.__post_init__(self)
        if len(self.replays) != len(self.races):
            raise ConfigError(f"{len(self.races)} races have {len(self.replays)} replays")

    @property
    def task(self) -> Task:
        """The task."""
        return find_task(self.plan.task)

    def to_dict(self) -> dict[str, Any]:
        """Returns the entry as JSON values."""
        return {
            "metric": self.task.metric,
            "score": self.score and asdict(self.score),
            "normalized": self.normalized_score,
            **BenchmarkResult.to_dict(self),
        }

    @cached_property
    def score(self) -> Estimate | None:
        """The task's metric over all races; ``None`` without races."""
        return self.group().figures[self.task.metric] if self.races else None

    @property
    def normalized_score(self) -> float | None:
        """The score on the scale where *random* has 0 and *zenith* has 1 in the same races.

        ``None`` without races, if the two have not been measured, on the training tracks and in
        fresh races, where they have other scores.
        """
        if self.score is None or self.plan.is_on_training_tracks or self.plan.fresh:
            return None
        return normalized(self.plan.task, self.score.value)


def plan_entry(
    task: str | Task,
    agent: str,
    *,
    split: str = TEST,
    about: About | None = None,
    fresh: str = "",
    settings: RaceSettings | None = None,
    **changes: Any,
) -> EntryPlan:
    """Plans the evaluation of an agent in a task.

    Args:
        task: the task, or its name.
        agent: the agent; see :func:`~stkzoo.evaluation.plan_benchmark`.
        split: ``"test"`` for the races of the task. ``"train"`` for the training tracks, with one
            race for each form, end of the grid, track and direction; the result is not an entry.
        about: what the entry says about its agent. stkzoo adds the class of its own drivers, and
            what its training programs know about their agents.
        fresh: text from which other seeds of the races are drawn, at most 200 characters, such as
            one that the organizer of a leaderboard publishes after the agents were handed in.
        settings: settings of every race, such as time limits of agents. The task sets the fields in
            ``EntryPlan.decided``.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that replace those of ``settings``.

    Raises:
        ConfigError: the task, the split or the agent does not exist, a setting is invalid, the
            agent requires another difficulty than the races have, or ``about`` has no class of an
            agent from files or another class of a driver of stkzoo.
        AssetError: the game's data is missing.
    """
    task = find_task(task) if isinstance(task, str) else task
    check_name("split", split, (TEST, TRAIN))
    _check_level(task, agent)
    is_test = split == TEST
    base = plan_benchmark(
        agent,
        split=task.test_tracks if is_test else task.train_tracks,
        difficulty=DIFFICULTY,
        forms=("P",),
        seeds=task.seeds if is_test else 1,
        settings=replace(
            EntryPlan.settings_of(settings, changes),
            max_paths=None,
            adapter=None,
            teams=bool(task.teams),
        ),
    )
    values = {entry.name: getattr(base, entry.name) for entry in fields(base)}
    return EntryPlan(
        **{**values, "forms": task.forms} | ({} if is_test else {"split": TRAIN}),
        task=task.name,
        task_digest=task.digest,
        population=population_digests(),
        about=(about or About()).completed(base.agent.source),
        fresh=fresh,
    )


def _check_level(task: Task, agent: str) -> None:
    """Refuses the game's AI at a difficulty of its own, which would change that of the races."""
    driver = find_driver(agent)
    if task.has_population and driver.difficulty is not None:
        raise ConfigError(
            f"{driver.source!r} requires difficulty {driver.difficulty}, but that of {task.name} "
            "depends on the race; name ai, which has the difficulty of each race"
        )


def _entry(plan: EntryPlan, results: RaceResults, folder: Path) -> Entry:
    races = race_outcomes(plan, results)
    replays = tuple(replay_digest(folder, race.number) for race in races)
    return Entry(plan, races, *shared_protections(results.values()), replays)


ENTRIES = BatchKind(EntryPlan, _entry, written(ENTRY_FILE), plot_benchmark, "entry.png")


def evaluate(
    task: str | Task, agent: str, *, output: str | os.PathLike[str], **options: Any
) -> Entry:
    """Evaluates an agent in a task, or resumes the evaluation that was started in ``output``.

    Args:
        task: the task, or its name.
        agent: the agent; see :func:`~stkzoo.evaluation.plan_benchmark`.
        output: folder for ``entry.json``, the replays and the result of each race.
        options: ``jobs``, ``race_timeout``, ``on_race`` and ``plot``, as in
            :class:`~stkzoo.evaluation.RunOptions`; all others as for :func:`plan_entry`.

    Raises:
        ConfigError: an argument is invalid, or ``output`` contains another evaluation.
        AssetError: the game's data is missing.
        BatchError: some races could not be run.
    """
    run, plan = RunOptions.split(options)
    return ENTRIES.run(plan_entry(task, agent, **plan), Path(output), run)
