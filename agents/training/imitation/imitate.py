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
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from stkzoo._arguments import option
from stkzoo._locks import locked_folder
from stkzoo._os import cpu_count, write_whole
from stkzoo._schema import Level
from stkzoo.agents.planning.motion import STEP
from stkzoo.agents.pretrained.action_filter import ActionFilter
from stkzoo.agents.pretrained.mlp import load_driver
from stkzoo.agents.pretrained.weights import load_weights, save_weights
from stkzoo.errors import AgentError, ConfigError, StkzooError
from stkzoo.evaluation import DemoView, record_demonstrations
from stkzoo.mdp import action_of, controls_of, kart_action_space, kart_observation_space
from stkzoo.race import Driver, DriverInstance, DriverRequest, find_driver, run_race
from stkzoo.wrappers.racing import controls_of_choices

from ..common.actors import end_with_parent
from ..common.arguments import (
    QUICK_TRACKS,
    Natural,
    NetworkArguments,
    RunArguments,
    ScriptOptions,
)
from ..common.command import ProgressBar, run_command
from ..common.matches import ai_time
from ..common.run_folder import keep_arguments, read_log, write_log
from ..export import export_policy
from ..plot import plot_runs
from ..ppo.network import RacingNetwork
from .lessons import Lesson, Numbers, fit, held_out

#: Time limit of a learner's race, as a multiple of the AI's median time.
PATIENCE = 1.7
#: Time ratio of a kart that does not finish.
UNFINISHED = 2.0
_COUNTDOWN = 20

_POLICY, _PLOT = "policy.safetensors", "imitation.png"
#: Arguments that may change when a run continues.
_FREE = ("rounds", "jobs")

#: Called with the current stage, the work done, and the total work.
Report = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class ImitationArguments(NetworkArguments):
    """Arguments of a run.

    Attributes:
        rounds: rounds of DAgger; 0 is behavior cloning only.
        n_epochs_last: passes over all lessons in the last round.
        difficulty: skill of the game's AI and speed of all karts, 0 to 3; the AI's
            times at it are the reference.
        teacher: driver to imitate: a driver of stkzoo, or a path.
        tracks: names of tracks or of splits, such as train_only.
        races: races on each track per round.
        karts: karts of the learner in each race.
        jobs: parallel races; 0 is the number of processors.
    """

    rounds: Natural = 5
    n_epochs: int = 20
    n_epochs_last: int = 20
    learning_rate: float = 1e-3
    difficulty: Level = 3
    teacher: str = "heuristic"
    tracks: tuple[str, ...] = option(QUICK_TRACKS, flag="--track", metavar="TRACK")
    races: int = 1
    karts: int = 3
    jobs: Natural = 0

    def __post_init__(self) -> None:
        RunArguments.__post_init__(self)
        if self.rounds:
            _check_teacher(self.teacher)


# ---------------------------------------------------------------------- rounds


def run(
    arguments: ImitationArguments, folder: Path, report: Report = lambda *_: None
) -> list[dict[str, Any]]:
    """Starts or continues an imitation: learns round by round.

    Args:
        arguments: arguments of the run.
        folder: folder of the run.
        report: called with the current stage, the work done, and the total work.

    Returns:
        The log, one line per round: the driver, its results, and the fit of the network. The last
            round only evaluates.

    Raises:
        ConfigError: an argument is invalid, torch is not installed, or the folder contains another
            run.
        AssetError: the game's data is missing.
    """
    keep_arguments(folder, arguments, _FREE)
    log = [line for line in read_log(folder) if "loss" in line]
    network = RacingNetwork(arguments.hidden, arguments.seed)
    if log:
        network.start_from(load_weights(_policy(folder, len(log) - 1)))
    for number in range(len(log), arguments.rounds + 2):
        lesson = _lesson(arguments, folder, number, report)
        log.append(_results(number, arguments.teacher, lesson))
        if number > arguments.rounds:
            break
        log[-1] |= _learn(arguments, folder, number, network, report)
        save_weights(_policy(folder, number), network.policy_weights())
        write_log(folder, log)
    write_log(folder, log)
    with write_whole(folder / _POLICY, "the policy") as part:
        shutil.copyfile(_policy(folder, arguments.rounds), part)
    export_policy(folder / _POLICY, "student", folder / "agent")
    return log


def _lesson(arguments: ImitationArguments, folder: Path, number: int, report: Report) -> Lesson:
    """Returns a round's lesson from its file, or drives its races."""
    file = _file(folder, number)
    if not file.exists():
        _drive_round(arguments, folder, number, report).save(file)
    return Lesson.load(file)


def _learn(
    arguments: ImitationArguments,
    folder: Path,
    number: int,
    network: RacingNetwork,
    report: Report,
) -> dict[str, Any]:
    """Trains the network on all lessons up to a round; returns figures for the log."""
    parts = [Lesson.load(_file(folder, n)) for n in range(number + 1)]
    sizes = [len(part.actions) for part in parts]
    lessons = Lesson.joined(parts)
    report(f"round {number}: learning from {len(lessons.actions):,} examples", 0, 1)
    fitted = fit(
        network,
        lessons.observations,
        lessons.actions,
        np.concatenate([held_out(size, (arguments.seed, n)) for n, size in enumerate(sizes)]),
        n_epochs=arguments.n_epochs_last if number == arguments.rounds else arguments.n_epochs,
        learning_rate=arguments.learning_rate,
        batch_size=arguments.batch_size,
        seed=arguments.seed + number,
    )
    return {"examples": len(lessons.actions), **fitted}


def _file(folder: Path, number: int) -> Path:
    return folder / f"lessons-{number:02d}.safetensors"


def _policy(folder: Path, number: int) -> Path:
    return folder / f"policy-{number:02d}.safetensors"


def _results(number: int, teacher: str, lesson: Lesson) -> dict[str, Any]:
    """Returns the log line of a round's races."""
    ratios, names = lesson.ratios, (teacher, "behavior cloning")
    return {
        "round": number,
        "driver": names[number] if number < 2 else f"DAgger, round {number - 1}",
        "time_ratio": round(float(np.mean(ratios)), 4),
        "error": round(float(np.std(ratios) / max(len(ratios) - 1, 1) ** 0.5), 4),
        "finished": round(lesson.finished / len(ratios), 4),
        "karts": len(ratios),
    }


# ---------------------------------------------------------------------- races


def _drive_round(
    arguments: ImitationArguments, folder: Path, number: int, report: Report
) -> Lesson:
    """Drives the races of a round: the teacher in the first one, then the learner."""
    if not number:
        return _demonstrations(arguments, folder, report)
    return Lesson.joined([*_drive(arguments, number, _policy(folder, number - 1), report)])


def _demonstrations(arguments: ImitationArguments, folder: Path, report: Report) -> Lesson:
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
    arguments: ImitationArguments, number: int, policy: Path, report: Report
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
        max_steps=_COUNTDOWN + math.ceil(PATIENCE * median / STEP),
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
    kinds, remedy = (ScriptOptions, ImitationArguments), "the same command continues"
    return run_command("imitation.imitate", __doc__, _show, kinds, words, remedy)


def _show(options: ScriptOptions, arguments: ImitationArguments) -> None:
    """Runs the command, shows its progress, and prints and plots its results."""
    folder, stages = options.output, list[str]()
    with locked_folder(folder, "run"), ProgressBar(1, unit="done") as bar:

        def report(stage: str, done: int, total: int) -> None:
            if not bar.is_shown and stage not in stages:
                print(stage, file=sys.stderr, flush=True)
            stages.append(stage)
            bar.show(done, stage, total)

        log = run(arguments, folder, report)
    for line in log:
        print(_summary(line))
    plot_runs([folder], folder / _PLOT)
    print(f"more in {folder}: {_POLICY}, {_PLOT}, agent; try: stkzoo race {folder / 'agent'} ai")


def _summary(line: Mapping[str, Any]) -> str:
    text = (
        f"{line['driver']}: time ratio {line['time_ratio']:.3f} +- {1.96 * line['error']:.3f}, "
        f"{line['finished']:.0%} of {line['karts']} karts finished"
    )
    if "examples" in line:
        steer = line["accuracy"][0]
        text += f"; then learned from {line['examples']:,} examples: steering right in {steer:.0%}"
    return text


if __name__ == "__main__":
    sys.exit(main())
