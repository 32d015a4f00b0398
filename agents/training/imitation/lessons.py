"""Rounds of learning from a teacher, shared by both scripts.

In the first round the teacher drives. In the others the learner drives, and the teacher labels the
visited states with the action it would take (DAgger: Ross, Gordon and Bagnell, 2011). After each
round the network learns from all lessons so far.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from stkzoo._arrays import read_arrays, write_arrays
from stkzoo._locks import locked_folder
from stkzoo._os import write_whole
from stkzoo._reading import reading
from stkzoo._schema import Level
from stkzoo.agents.pretrained.mlp import MlpDriver, load_driver
from stkzoo.agents.pretrained.weights import load_weights, save_weights
from stkzoo.wrappers.racing import SIZE

from ..common.arguments import NetworkArguments, ScriptOptions
from ..common.command import ProgressBar
from ..common.run_folder import keep_arguments, read_log, write_log
from ..export import export_policy
from ..plot import plot_runs
from ..ppo.network import RacingNetwork
from .network import fit, held_out

A = TypeVar("A")
Numbers = npt.NDArray[Any]

#: Largest size of a round's lessons [bytes].
_MAX_BYTES = 8 << 30

_POLICY, _PLOT = "policy.safetensors", "imitation.png"

#: Called with the current stage, the work done, and the total work.
Report = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class ImitationArguments(NetworkArguments):
    """Arguments of both scripts.

    Attributes:
        rounds: rounds in which the learner drives and learns.
        n_epochs_last: passes over all lessons in the last round.
        difficulty: skill of the game's AI and speed of all karts, 0 to 3; the AI's
            times at it are the reference.
    """

    #: Fields that may change when a run continues.
    free: ClassVar[tuple[str, ...]] = ("rounds",)

    rounds: int = 5
    n_epochs_last: int = 12
    difficulty: Level = 3


@dataclass(frozen=True, slots=True)
class Lesson:
    """Data of a round's races: ``N`` moments of all karts together.

    Attributes:
        observations: ``(N, inputs)`` float32, inputs of the learner.
        actions: ``(N, 5)``, choices of the teacher.
        ratios: time of each kart over the AI's time; a worst case if it did not finish.
        finished: number of karts that finished.
    """

    observations: Numbers
    actions: Numbers
    ratios: tuple[float, ...]
    finished: int

    @classmethod
    def joined(cls, lessons: Sequence[Lesson]) -> Lesson:
        """Returns several lessons as one."""
        return cls(
            np.concatenate([lesson.observations for lesson in lessons]),
            np.concatenate([lesson.actions for lesson in lessons]),
            tuple(ratio for lesson in lessons for ratio in lesson.ratios),
            sum(lesson.finished for lesson in lessons),
        )

    def save(self, path: Path) -> None:
        """Writes the lesson to a file atomically."""
        arrays = {
            "observations": self.observations,
            "actions": self.actions.astype(np.int8),
            "ratios": np.array(self.ratios),
            "finished": np.array(self.finished),
        }
        write_arrays(path, arrays, "the lesson")

    @classmethod
    def load(cls, path: Path) -> Lesson:
        """Reads a file that :meth:`save` wrote.

        Raises:
            ConfigError: the file is damaged.
        """
        with reading(f"{path} is unreadable", "a round's lessons; delete it to drive it again"):
            arrays, _ = read_arrays(path, _MAX_BYTES)
            ratios, finished = tuple(arrays["ratios"].tolist()), int(arrays["finished"])
            return cls(arrays["observations"], arrays["actions"], ratios, finished)


def run_rounds(
    arguments: ImitationArguments,
    folder: Path,
    teacher: str,
    drive: Callable[[int, Path | None], Lesson],
    report: Report,
    *,
    inputs: int = SIZE,
    hold: int = 0,
    judge: Callable[[MlpDriver], dict[str, float]] | None = None,
) -> list[dict[str, Any]]:
    """Learns round by round; starts or continues a run.

    Args:
        arguments: arguments of the run.
        folder: folder of the run.
        teacher: name of the teacher in the log.
        drive: drives the races of a round; called with its number and the file of the policy that
            drives, or ``None`` for the teacher.
        report: called in each round.
        inputs: size of the network's input.
        hold: minimum steps of the network's drifts.
        judge: returns figures on each round's network for the log. Without it, a last round only
            evaluates.

    Returns:
        The log, one line per round: the driver, its results, and the fit of the network.

    Raises:
        ConfigError: torch is not installed, or the folder contains another run.
    """
    keep_arguments(folder, arguments, arguments.free)
    log = [line for line in read_log(folder) if "loss" in line]
    network = RacingNetwork(arguments.hidden, arguments.seed, inputs=inputs, hold=hold)
    if log:
        network.start_from(load_weights(_policy(folder, len(log) - 1)))
    for number in range(len(log), arguments.rounds + (1 if judge else 2)):
        lesson = _lesson(folder, number, drive)
        log.append(_driven(number, teacher, lesson))
        if judge is None and number > arguments.rounds:
            break
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
        save_weights(_policy(folder, number), network.policy_weights())
        figures = judge(load_driver(_policy(folder, number))) if judge else {}
        log[-1] |= {"examples": len(lessons.actions), **fitted, **figures}
        write_log(folder, log)
    write_log(folder, log)
    with write_whole(folder / _POLICY, "the policy") as part:
        shutil.copyfile(_policy(folder, arguments.rounds), part)
    export_policy(folder / _POLICY, "student", folder / "agent")
    return log


def _lesson(folder: Path, number: int, drive: Callable[[int, Path | None], Lesson]) -> Lesson:
    """Returns a round's lesson from its file, or drives its races."""
    file = _file(folder, number)
    if not file.exists():
        drive(number, _policy(folder, number - 1) if number else None).save(file)
    return Lesson.load(file)


def _file(folder: Path, number: int) -> Path:
    return folder / f"lessons-{number:02d}.safetensors"


def _policy(folder: Path, number: int) -> Path:
    return folder / f"policy-{number:02d}.safetensors"


def _driven(number: int, teacher: str, lesson: Lesson) -> dict[str, Any]:
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


def _summary(line: Mapping[str, Any]) -> str:
    text = (
        f"{line['driver']}: time ratio {line['time_ratio']:.3f} +- {1.96 * line['error']:.3f}, "
        f"{line['finished']:.0%} of {line['karts']} karts finished"
    )
    if "examples" in line:
        steer = line["accuracy"][0]
        text += f"; then learned from {line['examples']:,} examples: steering right in {steer:.0%}"
    if "time_ratio_alone" in line:
        text += (
            f"; alone {line['time_ratio_alone']:.3f} of the AI's time, "
            f"{line['unfinished']} unfinished"
        )
    return text


def show_rounds(
    run: Callable[[A, Path, Report], list[dict[str, Any]]], options: ScriptOptions, arguments: A
) -> None:
    """Runs a script, shows its progress, and prints and plots its results.

    Args:
        run: the script; returns the log.
        options: folder of the run.
        arguments: arguments of the run.
    """
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
