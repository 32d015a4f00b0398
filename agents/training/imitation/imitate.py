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
import json
import multiprocessing
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo._os import atomic_write, cpu_count
from stkzoo.errors import ConfigError, StkzooError, check_whole
from stkzoo.evaluation import Demonstrations, load_demonstrations, record_demonstrations
from stkzoo.race import find_driver

from ..common.arguments import (
    QUICK_TRACKS,
    NetworkArguments,
    add_arguments,
    keep_arguments,
    track_names,
    values_of,
    write_json,
)
from ..common.command import ProgressBar, command_parser, run_command
from ..common.network_policy import save_driver
from ..common.training_log import write_log
from ..export import export_policy
from ..plot import plot_imitation
from .network import Fit, fit, load_weights_into, make_network
from .races import (
    Lesson,
    LessonOrder,
    Numbers,
    end_with_parent,
    read_lesson,
    run_order,
    time_ratio,
)

_POLICY, _PLOT = "policy.safetensors", "imitation.png"
#: What may change when a run continues.
_FREE = ("rounds", "jobs")


@dataclass(frozen=True, slots=True)
class ImitationArguments(NetworkArguments):
    """Arguments of a run.

    Attributes:
        teacher: the driver to imitate: a driver of stkzoo, or a path.
        demos: file of stkzoo demos to learn from first; empty records one.
        rounds: rounds of DAgger; 0 is behaviour cloning alone.
        tracks: names of tracks, or train.
        races: races on each track in a round.
        karts: karts of the learner in each race.
        difficulty: of the game's AI, whose times are compared with.
        jobs: races at a time; 0 is the number of processors.
    """

    n_epochs: int = 20
    learning_rate: float = 1e-3
    teacher: str = "heuristic"
    demos: str = ""
    rounds: int = 5
    tracks: tuple[str, ...] = QUICK_TRACKS
    races: int = 1
    karts: int = 3
    difficulty: int = 3
    jobs: int = 0

    def __post_init__(self) -> None:
        for name, least in (("rounds", 0), ("races", 1), ("karts", 1), ("n_epochs", 1)):
            check_whole(name, getattr(self, name), least)
        check_whole("batch_size", self.batch_size, 1)
        check_whole("jobs", self.jobs, 0)
        if find_driver(self.teacher, inline=True).is_game_ai and self.rounds:
            raise ConfigError(
                "the game's AI cannot be asked what it would do in a kart that it does not drive; "
                "give --rounds 0 (behaviour cloning alone), or another --teacher"
            )


Report = Callable[[str, int, int], None]


def run(
    arguments: ImitationArguments, folder: Path, report: Report = lambda *_: None
) -> list[dict[str, Any]]:
    """Imitates, or continues a run.

    Args:
        arguments: of the run.
        folder: the run's.
        report: called with what is being done, how much of it is done, and how much there is.

    Returns:
        The log: for each round the driver, its results, and the fit of the network after it.

    Raises:
        ConfigError: an argument is invalid, torch is not installed, or the folder has another run.
        AssetError: the game's data is missing.
    """
    keep_arguments(folder, arguments, _FREE)
    demos = _demonstrations(arguments, folder, report)
    examples = [demos.pairs()]
    log = [_line(0, arguments.teacher, *_of_demos(demos, arguments.difficulty))]
    for number in range(arguments.rounds + 2):
        if number:
            driven = _drive(arguments, folder, number, report)
            examples += [(lesson.observations, lesson.actions) for lesson in driven]
            ratios = [ratio for lesson in driven for ratio in lesson.ratios]
            finished = sum(lesson.finished for lesson in driven)
            who = "behaviour cloning" if number == 1 else f"DAgger, round {number - 1}"
            log.append(_line(number, who, ratios, finished))
        if number <= arguments.rounds:
            log[-1] |= _learn(arguments, folder, number, examples, report)
        write_log(folder, log)
    _finish(arguments, folder)
    return log


def _demonstrations(arguments: ImitationArguments, folder: Path, report: Report) -> Demonstrations:
    if arguments.demos:
        demos = load_demonstrations(arguments.demos)
        if demos.view != "racing":
            raise ConfigError(
                f"{arguments.demos} was recorded in the view {demos.view!r}, expected racing; "
                "record it with stkzoo demos --view racing"
            )
        return demos
    first = 1000 * arguments.seed
    return record_demonstrations(
        arguments.teacher,
        output=folder / "demos.npz",
        tracks=track_names(arguments.tracks),
        seeds=range(first, first + arguments.races),
        karts=arguments.karts,
        difficulty=arguments.difficulty,
        jobs=arguments.jobs or None,
        on_race=lambda progress: report("the teacher drives", progress.done, progress.total),
    )


def _of_demos(demos: Demonstrations, difficulty: int) -> tuple[list[float], int]:
    ratios = [time_ratio(f.finish_time, f.track, f.reverse, difficulty) for f in demos.facts]
    return ratios, sum(facts.finish_time is not None for facts in demos.facts)


def _line(number: int, driver: str, ratios: Sequence[float], finished: int) -> dict[str, Any]:
    """The log line of a round's races."""
    return {
        "round": number,
        "driver": driver,
        "time_ratio": round(float(np.mean(ratios)), 4),
        "error": round(float(np.std(ratios) / max(len(ratios) - 1, 1) ** 0.5), 4),
        "finished": round(finished / len(ratios), 4),
        "karts": len(ratios),
    }


# ------------------------------------------------------------------ a round


def _drive(
    arguments: ImitationArguments, folder: Path, number: int, report: Report
) -> list[Lesson]:
    """The races of a round; those with a file are not driven again."""
    home = folder / f"round_{number:02d}"
    home.mkdir(exist_ok=True)
    first = 1000 * arguments.seed + 100 * number
    kinds = itertools.product(track_names(arguments.tracks), range(first, first + arguments.races))
    orders = [
        LessonOrder(
            teacher=arguments.teacher,
            policy=str(_policy_file(folder, number - 1)),
            track=track,
            reverse=False,
            seed=seed,
            karts=arguments.karts,
            difficulty=arguments.difficulty,
            file=str(home / f"{track}-{seed}.npz"),
        )
        for track, seed in kinds
    ]
    left = [order for order in orders if not Path(order.file).exists()]
    what = f"round {number}: the learner drives"
    report(what, len(orders) - len(left), len(orders))
    for done, _ in enumerate(_in_parallel(left, arguments.jobs), start=1):
        report(what, len(orders) - len(left) + done, len(orders))
    return [read_lesson(order.file) for order in orders]


def _in_parallel(orders: Sequence[LessonOrder], jobs: int) -> Iterator[str]:
    if not orders:
        return
    context = multiprocessing.get_context("spawn")
    workers = min(jobs or cpu_count(), len(orders))
    with ProcessPoolExecutor(workers, context, end_with_parent) as pool:
        tasks = [pool.submit(run_order, order) for order in orders]
        try:
            for task in as_completed(tasks):
                yield task.result()
        except BrokenProcessPool as error:
            raise StkzooError(
                f"a process that drove died ({error}); the same command continues"
            ) from error
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _learn(
    arguments: ImitationArguments,
    folder: Path,
    number: int,
    examples: Sequence[tuple[Numbers, Numbers]],
    report: Report,
) -> dict[str, Any]:
    """Trains the round's network, or reads the result; its figures for the log."""
    file, facts = _policy_file(folder, number), folder / f"fit_{number:02d}.json"
    if file.exists() and facts.exists():
        found: dict[str, Any] = json.loads(facts.read_text())
        return found
    observations, actions = (np.concatenate(part) for part in zip(*examples, strict=True))
    report(f"round {number}: learning from {len(actions):,} examples", 0, 1)
    network = make_network(arguments.hidden, arguments.seed)
    if number:
        load_weights_into(network, _policy_file(folder, number - 1))
    result: Fit = fit(
        network,
        observations,
        actions,
        n_epochs=arguments.n_epochs,
        learning_rate=arguments.learning_rate,
        batch_size=arguments.batch_size,
        seed=arguments.seed + number,
    )
    save_driver(file, network)
    line = {"examples": len(actions), "loss": result.loss, "accuracy": list(result.accuracy)}
    write_json(facts, line)
    return line


def _policy_file(folder: Path, number: int) -> Path:
    return folder / f"policy-{number:02d}.safetensors"


def _finish(arguments: ImitationArguments, folder: Path) -> None:
    """The last round's policy as the run's, and as an agent."""
    with atomic_write(folder / _POLICY) as part:
        shutil.copyfile(_policy_file(folder, arguments.rounds), part)
    export_policy(folder / _POLICY, "student", folder / "agent")


def _summary(line: dict[str, Any]) -> str:
    text = (
        f"{line['driver']}: time ratio {line['time_ratio']:.3f} +- {1.96 * line['error']:.3f}, "
        f"{line['finished']:.0%} of {line['karts']} karts finished"
    )
    if "examples" in line:
        steer = line["accuracy"][0]
        text += f"; then learned from {line['examples']:,} examples: steering right in {steer:.0%}"
    return text


def parse(words: list[str] | None = None) -> tuple[ImitationArguments, Path]:
    """Parses the command line.

    Raises:
        ConfigError: an argument is invalid.
    """
    parser = command_parser("imitation.imitate", __doc__)
    parser.add_argument("--output", type=Path, required=True, help="the run's folder")
    add_arguments(parser, ImitationArguments)
    options = vars(parser.parse_args(words))
    folder = options.pop("output")
    return ImitationArguments(**values_of(options)), folder


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    return run_command(lambda: _imitate(words), "the same command continues")


def _imitate(words: list[str] | None) -> None:
    arguments, folder = parse(words)
    stages: list[str] = []
    with ProgressBar(1, unit="done") as bar:

        def report(stage: str, done: int, total: int) -> None:
            if not bar.is_shown and stage not in stages:
                print(stage, file=sys.stderr, flush=True)
            stages.append(stage)
            bar.show(done, stage, total)

        log = run(arguments, folder, report)
    for line in log:
        print(_summary(line))
    plot_imitation(log, folder / _PLOT)
    print(f"more in {folder}: {_POLICY}, {_PLOT}, agent; try: stkzoo race {folder / 'agent'} ai")


if __name__ == "__main__":
    sys.exit(main())
