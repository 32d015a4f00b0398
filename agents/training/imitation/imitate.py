r"""Learns to drive like a teacher: behaviour cloning, then DAgger.

    python -m stkzoo.agents.training.imitation.imitate --output runs/imitate
    python -m stkzoo.agents.training.imitation.imitate --output runs/ai --demos ai.npz --rounds 0
    python -m stkzoo.agents.training.sb3.selfplay --output runs/play \
        --init runs/imitate/policy.safetensors

First a network learns from demonstrations (those of `stkzoo demos`, or new ones) what the teacher
did where the teacher came: behaviour cloning. But a copy that errs gets where the teacher never
was. So in each round of DAgger (Ross, Gordon and Bagnell, 2011) the learner drives, the teacher
labels what it would have done there, and the network learns from all of it. A last round only
drives, to evaluate the result.

The learner sees the view ``racing`` and is a ``MlpPolicy`` of Stable-Baselines3, two tanh layers.
In the folder: ``policy.safetensors`` (its state dict), ``agent`` (to race: `stkzoo race
runs/imitate/agent ai`), ``log.jsonl``, ``imitation.png``, and the lessons. The same command
continues a run that was killed.
"""

from __future__ import annotations

import itertools
import multiprocessing
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from stkzoo._os import cpu_count
from stkzoo.errors import ConfigError, StkzooError
from stkzoo.evaluation import load_demonstrations, record_demonstrations
from stkzoo.race import find_driver

from ..common.arguments import QUICK_TRACKS, RunArguments, track_names
from ..common.command import parse_script, run_command
from .lessons import ImitationArguments, Lesson, Report, run_rounds, show_rounds
from .races import drive_race, end_with_parent, time_ratio


@dataclass(frozen=True, slots=True)
class TeacherArguments(ImitationArguments):
    """Arguments of a run.

    Attributes:
        teacher: the driver to imitate: a driver of stkzoo, or a path.
        demos: file of stkzoo demos to learn from first; empty records one.
        rounds: rounds of DAgger; 0 is behaviour cloning alone.
        tracks: names of tracks, or train.
        races: races on each track in a round.
        karts: karts of the learner in each race.
        jobs: races at a time; 0 is the number of processors.
    """

    may_be_zero: ClassVar[tuple[str, ...]] = ("seed", "rounds", "difficulty", "jobs")
    free: ClassVar[tuple[str, ...]] = ("rounds", "jobs")

    n_epochs: int = 20
    n_epochs_last: int = 20
    learning_rate: float = 1e-3
    teacher: str = "heuristic"
    demos: str = ""
    tracks: tuple[str, ...] = QUICK_TRACKS
    races: int = 1
    karts: int = 3
    jobs: int = 0

    def __post_init__(self) -> None:
        RunArguments.__post_init__(self)
        if find_driver(self.teacher, inline=True).is_game_ai and self.rounds:
            raise ConfigError(
                "the game's AI cannot be asked what it would do in a kart that it does not drive; "
                "give --rounds 0 (behaviour cloning alone), or another --teacher"
            )


def run(
    arguments: TeacherArguments, folder: Path, report: Report = lambda *_: None
) -> list[dict[str, Any]]:
    """Imitates, or continues a run.

    Args:
        arguments: of the run.
        folder: the run's.
        report: called with what is being done, how much of it is done, and how much there is.

    Returns:
        The log; see :func:`.lessons.run_rounds`.

    Raises:
        ConfigError: an argument is invalid, torch is not installed, or the folder has another run.
        AssetError: the game's data is missing.
    """

    def drive(number: int, policy: Path | None) -> Lesson:
        if policy is None:
            return _demonstrations(arguments, folder, report)
        return Lesson.joined([*_drive(arguments, number, policy, report)])

    return run_rounds(arguments, folder, arguments.teacher, drive, report)


def _demonstrations(arguments: TeacherArguments, folder: Path, report: Report) -> Lesson:
    """The lesson of a data set of demonstrations, or of a new one."""
    first = 1000 * arguments.seed
    if arguments.demos:
        demos = load_demonstrations(arguments.demos)
        if demos.view != "racing":
            raise ConfigError(
                f"{arguments.demos} was recorded in the view {demos.view!r}, expected racing; "
                "record it with stkzoo demos --view racing"
            )
    else:
        demos = record_demonstrations(
            arguments.teacher,
            output=folder / "demos.npz",
            tracks=track_names(arguments.tracks),
            seeds=range(first, first + arguments.races),
            karts=arguments.karts,
            difficulty=arguments.difficulty,
            jobs=arguments.jobs or None,
            on_race=lambda progress: report("the teacher drives", progress.done, progress.total),
        )
    ratios = tuple(
        time_ratio(kart.finish_time, kart.track, kart.reverse, arguments.difficulty)
        for kart in demos.facts
    )
    finished = sum(kart.finish_time is not None for kart in demos.facts)
    return Lesson(*demos.pairs(), ratios, finished)


def _drive(
    arguments: TeacherArguments, number: int, policy: Path, report: Report
) -> Iterator[Lesson]:
    """The lessons of a round's races, which run side by side in processes."""
    first = 1000 * arguments.seed + 100 * number
    seeds = range(first, first + arguments.races)
    places = list(itertools.product(track_names(arguments.tracks), seeds))
    tracks, numbers = zip(*places, strict=True)
    drive = partial(
        drive_race, arguments.teacher, str(policy), arguments.karts, arguments.difficulty
    )
    what = f"round {number}: the learner drives"
    workers = min(arguments.jobs or cpu_count(), len(places))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, end_with_parent) as pool:
        report(what, 0, len(places))
        try:
            for done, lesson in enumerate(pool.map(drive, tracks, numbers), start=1):
                report(what, done, len(places))
                yield lesson
        except BrokenProcessPool as error:
            raise StkzooError(
                f"a process that drove died ({error}); the same command continues"
            ) from error
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""

    def imitate() -> None:
        arguments, own = parse_script("imitation.imitate", __doc__, TeacherArguments, words)
        folder = own["output"]
        show_rounds(lambda report: run(arguments, folder, report), folder)

    return run_command(imitate, "the same command continues")


if __name__ == "__main__":
    sys.exit(main())
