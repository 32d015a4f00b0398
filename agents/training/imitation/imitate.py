r"""Imitates a driver: behavior cloning, followed by DAgger.

    python -m stkzoo.agents.training.imitation.imitate --output runs/imitate
    python -m stkzoo.agents.training.imitation.imitate --output runs/ai --teacher ai --rounds 0
    python -m stkzoo.agents.training.sb3.selfplay --output runs/play \
        --init runs/imitate/policy.safetensors

First, a network learns the teacher's actions from its races: behavior cloning. Its errors lead it
to states that the teacher never visited. Therefore, in each round of DAgger (Ross, Gordon and
Bagnell, 2011) the learner drives, the teacher labels these states with its own action, and the
network learns from all data so far. The last round only evaluates the result.

The learner sees the view ``racing`` and is an ``MlpPolicy`` of Stable-Baselines3 with two tanh
layers. The folder contains ``policy.safetensors`` (its state dict), ``agent`` (to race: `stkzoo
race runs/imitate/agent ai`), ``log.jsonl``, ``imitation.png`` and the data of the rounds. To
continue a run that was killed, run the same command again.
"""

from __future__ import annotations

import itertools
import math
import multiprocessing
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces

from stkzoo._arguments import option
from stkzoo._os import cpu_count
from stkzoo.agents.pretrained.action_filter import ActionFilter
from stkzoo.agents.pretrained.mlp import load_driver
from stkzoo.errors import AgentError, ConfigError, StkzooError
from stkzoo.evaluation import DemoView, record_demonstrations
from stkzoo.mdp import action_of, controls_of, kart_action_space, kart_observation_space
from stkzoo.race import Driver, DriverInstance, DriverRequest, find_driver, run_race
from stkzoo.wrappers.racing import controls_of_choices

from ..common.actors import end_with_parent
from ..common.arguments import QUICK_TRACKS, Natural, RunArguments, ScriptOptions
from ..common.command import run_command
from ..common.matches import ai_time
from .lessons import ImitationArguments, Lesson, Numbers, Report, run_rounds, show_rounds

#: Time limit of a learner's race, as a multiple of the AI's median time.
PATIENCE = 1.7
#: Time ratio of a kart that does not finish.
UNFINISHED = 2.0
_STEP, _COUNTDOWN = 0.1, 20


@dataclass(frozen=True, slots=True)
class TeacherArguments(ImitationArguments):
    """Arguments of a run.

    Attributes:
        teacher: driver to imitate: a driver of stkzoo, or a path.
        rounds: rounds of DAgger; 0 is behavior cloning only.
        tracks: names of tracks or of splits, such as train_only.
        races: races on each track per round.
        karts: karts of the learner in each race.
        jobs: parallel races; 0 is the number of processors.
    """

    free: ClassVar[tuple[str, ...]] = ("rounds", "jobs")

    rounds: Natural = 5
    n_epochs: int = 20
    n_epochs_last: int = 20
    learning_rate: float = 1e-3
    teacher: str = "heuristic"
    tracks: tuple[str, ...] = option(QUICK_TRACKS, flag="--track", metavar="TRACK")
    races: int = 1
    karts: int = 3
    jobs: Natural = 0

    def __post_init__(self) -> None:
        RunArguments.__post_init__(self)
        if self.rounds:
            _check_teacher(self.teacher)


def run(
    arguments: TeacherArguments, folder: Path, report: Report = lambda *_: None
) -> list[dict[str, Any]]:
    """Starts or continues an imitation.

    Args:
        arguments: arguments of the run.
        folder: folder of the run.
        report: called with the current stage, the work done, and the total work.

    Returns:
        The log; see :func:`.lessons.run_rounds`.

    Raises:
        ConfigError: an argument is invalid, torch is not installed, or the folder contains another
            run.
        AssetError: the game's data is missing.
    """

    def drive(number: int, policy: Path | None) -> Lesson:
        if policy is None:
            return _demonstrations(arguments, folder, report)
        return Lesson.joined([*_drive(arguments, number, policy, report)])

    return run_rounds(arguments, folder, arguments.teacher, drive, report)


def _demonstrations(arguments: TeacherArguments, folder: Path, report: Report) -> Lesson:
    """Returns the lesson from recorded demonstrations of the teacher."""
    first = 1000 * arguments.seed
    demos = record_demonstrations(
        arguments.teacher,
        output=folder / "demos.safetensors",
        tracks=arguments.tracks,
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
    """Yields the lessons of a round's races, which run in parallel processes."""
    first = 1000 * arguments.seed + 100 * number
    seeds = range(first, first + arguments.races)
    places = list(itertools.product(arguments.tracks, seeds))
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


# ---------------------------------------------------------------------- races


def time_ratio(time: float | None, track: str, reverse: bool, difficulty: int) -> float:
    """Returns a finish time over the AI's median time."""
    if time is None:
        return UNFINISHED
    return min(time / ai_time(track, reverse, difficulty), UNFINISHED)


def drive_race(
    teacher: str, policy: str, karts: int, difficulty: int, track: str, seed: int
) -> Lesson:
    """Drives a race in which the learner controls all karts, through the filter of its agent.

    Args:
        teacher: driver that labels the states; see :func:`~stkzoo.race.find_driver`.
        policy: file of the learner's weights.
        karts: number of karts.
        difficulty: difficulty of the race, and of the AI whose time is the reference.
        track: track of the race.
        seed: seed of the race.
    """
    driver, view = load_driver(policy), DemoView("racing")
    seen: list[Numbers] = []
    labels: list[Numbers] = []

    def make_actor(
        _: spaces.Space[Any], __: spaces.Space[Any], seed: int
    ) -> Callable[[Any], dict[str, Any]]:
        instance, action_filter = _instance(teacher, seed), ActionFilter(1, driver.hold)

        def act(observation: Any) -> dict[str, Any]:
            inputs = view.observe(observation)
            instance.ask(observation)
            answer = np.array(controls_of(instance.answer().action), np.float32)
            seen.append(inputs)
            labels.append(view.action(observation, answer))
            choices = action_filter.drive(inputs, driver.best)
            return action_of(controls_of_choices(choices[None])[0])

        return act

    median = ai_time(track, False, difficulty)
    result = run_race(
        [Driver.of_actor(f"learner {kart}", make_actor) for kart in range(karts)],
        track=track,
        seed=seed,
        difficulty=difficulty,
        error_handling="raise",
        max_steps=_COUNTDOWN + math.ceil(PATIENCE * median / _STEP),
        action_timeout=None,
    )
    times = [row.finish_time for row in result.agents]
    ratios = tuple(time_ratio(time, track, False, difficulty) for time in times)
    finished = sum(time is not None for time in times)
    return Lesson(np.array(seen, np.float32), np.array(labels, np.int8), ratios, finished)


def _check_teacher(teacher: str) -> None:
    """Checks that the teacher can say what it would do in a kart of the learner.

    Raises:
        ConfigError: it cannot, as the game's AI, and the planner, which copies races that it
            drives.
    """
    try:
        _instance(teacher, 0).close()
    except AgentError as error:
        raise ConfigError(
            f"{teacher} cannot label what a learner sees ({error}); give --rounds 0 (behavior "
            "cloning alone), or another --teacher"
        ) from error


def _instance(teacher: str, seed: int) -> DriverInstance:
    """Returns an instance of the teacher."""
    start = find_driver(teacher, inline=True).start
    if start is None:
        raise AgentError("the game's AI drives only its own karts")
    instance = start(DriverRequest("kart_0", kart_observation_space(), kart_action_space(), seed))
    instance.ready()
    return instance


# ---------------------------------------------------------------------- the command


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    kinds, show = (ScriptOptions, TeacherArguments), partial(show_rounds, run)
    remedy = "the same command continues"
    return run_command("imitation.imitate", __doc__, show, kinds, words, remedy)


if __name__ == "__main__":
    sys.exit(main())
