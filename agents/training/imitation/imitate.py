r"""Learns to drive like a teacher: behaviour cloning, then DAgger.

    python -m stkzoo.agents.training.imitation.imitate --output runs/imitate
    python -m stkzoo.agents.training.imitation.imitate --output runs/ai --demos ai.npz --rounds 0
    python -m stkzoo.agents.training.sb3.selfplay --output runs/play \
        --start runs/imitate/policy.safetensors

First a network learns from demonstrations (those of `stkzoo demos`, or ones that are recorded now)
what the teacher did where the teacher came: behaviour cloning. But a copy that errs comes where the
teacher never was. So in each round of DAgger (Ross, Gordon and Bagnell, 2011) the learner drives,
the teacher says what it would have done there, and the network learns from all of it together. A
last round only drives, to see how good the result is.

The learner sees the view ``racing`` and is a ``MlpPolicy`` of Stable-Baselines3, two tanh layers.
In the folder: ``policy.safetensors`` (its state dict), ``agent`` (to race: `stkzoo race
runs/imitate/agent ai`), ``log.jsonl``, ``imitation.png``, and the lessons. A killed run goes on
when the same command is given again.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
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
from stkzoo.tracks import SPLITS

from ..common.arguments import add_arguments, keep_arguments, values_of
from ..common.training_log import write_log
from ..sb3.policy import save_driver, write_agent
from .network import Fit, fit, make_network, take_over
from .races import (
    Lesson,
    LessonOrder,
    Numbers,
    end_with_parent,
    read_lesson,
    run_order,
    time_ratio,
)

__all__ = ["Arguments", "main", "parse", "plot_log", "run"]

_POLICY, _PICTURE = "policy.safetensors", "imitation.png"
#: What may be other when a run goes on.
_FREE = ("rounds", "jobs")


@dataclass(frozen=True, slots=True)
class Arguments:
    """What a run is made of.

    Attributes:
        teacher: who is imitated: a driver that comes with stkzoo, a path.
        demos: learn first from this file of stkzoo demos; empty records one.
        rounds: of DAgger; 0 is behaviour cloning alone.
        tracks: names of tracks, or train.
        leave_out: but not these; none for all of them.
        races: of each track in a round.
        karts: of the learner in each race.
        difficulty: of the game's AI, whose times are compared with.
        hidden: units of the layers.
        epochs: how often a round goes over all examples.
        batch: examples of a gradient.
        learning_rate: of Adam, at a round's start.
        seed: of everything.
        jobs: races at a time; 0 is as many as processors.
    """

    teacher: str = "heuristic"
    demos: str = ""
    rounds: int = 5
    tracks: tuple[str, ...] = ("train",)
    leave_out: tuple[str, ...] = ("black_forest",)
    races: int = 1
    karts: int = 3
    difficulty: int = 3
    hidden: tuple[int, ...] = (256, 128)
    epochs: int = 20
    batch: int = 512
    learning_rate: float = 1e-3
    seed: int = 0
    jobs: int = 0

    def __post_init__(self) -> None:
        for name, least in (("rounds", 0), ("races", 1), ("karts", 1), ("epochs", 1), ("batch", 1)):
            check_whole(name, getattr(self, name), least)
        check_whole("jobs", self.jobs, 0)
        if find_driver(self.teacher, inline=True).is_game_ai and self.rounds:
            raise ConfigError(
                "the game's AI cannot be asked what it would do in a kart that it does not drive; "
                "give --rounds 0 (behaviour cloning alone), or another --teacher"
            )

    @property
    def all_tracks(self) -> list[str]:
        """The tracks by name."""
        names = [t for name in self.tracks for t in SPLITS.get(name, (name,))]
        return [name for name in names if name not in self.leave_out]


@dataclass(frozen=True, slots=True)
class _Examples:
    """What is learned from in a round: observations ``(N, 165)`` and actions ``(N, 5)``."""

    observations: Numbers
    actions: Numbers


Tell = Callable[[str, int, int], None]


def run(arguments: Arguments, folder: Path, tell: Tell = lambda *_: None) -> list[dict[str, Any]]:
    """Imitates, or goes on with that.

    Args:
        arguments: of the run.
        folder: the run's.
        tell: is told what is being done, how much of it is, and how much there is.

    Returns:
        The log: for each round who drove, how well, and how well the network fitted then.

    Raises:
        ConfigError: an argument cannot be, torch is missing, or the folder has another run.
        AssetError: the game's data is missing.
    """
    keep_arguments(folder, arguments, _FREE)
    demos = _demonstrations(arguments, folder, tell)
    observations, actions = demos.pairs()
    lessons = [_Examples(observations, actions)]
    log = [_line(0, arguments.teacher, *_of_demos(demos, arguments.difficulty))]
    for number in range(arguments.rounds + 2):
        if number:
            driven = _drive(arguments, folder, number, tell)
            lessons += [_Examples(lesson.observations, lesson.actions) for lesson in driven]
            ratios = [ratio for lesson in driven for ratio in lesson.ratios]
            finished = sum(lesson.finished for lesson in driven)
            who = "behaviour cloning" if number == 1 else f"DAgger, round {number - 1}"
            log.append(_line(number, who, ratios, finished))
        if number <= arguments.rounds:
            log[-1] |= _learn(arguments, folder, number, lessons, tell)
        write_log(folder, log)
    _finish(arguments, folder)
    return log


def _demonstrations(arguments: Arguments, folder: Path, tell: Tell) -> Demonstrations:
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
        tracks=arguments.all_tracks,
        seeds=range(first, first + arguments.races),
        karts=arguments.karts,
        difficulty=arguments.difficulty,
        jobs=arguments.jobs or None,
        on_race=lambda progress: tell("the teacher drives", progress.done, progress.total),
    )


def _of_demos(demos: Demonstrations, difficulty: int) -> tuple[list[float], int]:
    ratios = [time_ratio(f.finish_time, f.track, f.reverse, difficulty) for f in demos.facts]
    return ratios, sum(facts.finish_time is not None for facts in demos.facts)


def _line(number: int, driver: str, ratios: Sequence[float], finished: int) -> dict[str, Any]:
    """What the log says of the races of a round."""
    return {
        "round": number,
        "driver": driver,
        "time_ratio": round(float(np.mean(ratios)), 4),
        "error": round(float(np.std(ratios) / max(len(ratios) - 1, 1) ** 0.5), 4),
        "finished": round(finished / len(ratios), 4),
        "karts": len(ratios),
    }


# ------------------------------------------------------------------ a round


def _drive(arguments: Arguments, folder: Path, number: int, tell: Tell) -> list[Lesson]:
    """The races of a round; those that are there are not driven again."""
    home = folder / f"round_{number:02d}"
    home.mkdir(exist_ok=True)
    first = 1000 * arguments.seed + 100 * number
    kinds = itertools.product(arguments.all_tracks, range(first, first + arguments.races))
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
    tell(what, len(orders) - len(left), len(orders))
    for done, _ in enumerate(_in_parallel(left, arguments.jobs), start=1):
        tell(what, len(orders) - len(left) + done, len(orders))
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
                f"a process that drove died ({error}); the same command goes on"
            ) from error
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _learn(
    arguments: Arguments, folder: Path, number: int, lessons: Sequence[_Examples], tell: Tell
) -> dict[str, Any]:
    """Trains the round's network, or reads what it came to; what the log says of it."""
    file, facts = _policy_file(folder, number), folder / f"fit_{number:02d}.json"
    if file.exists() and facts.exists():
        found: dict[str, Any] = json.loads(facts.read_text())
        return found
    observations = np.concatenate([lesson.observations for lesson in lessons])
    actions = np.concatenate([lesson.actions for lesson in lessons])
    tell(f"round {number}: learning from {len(actions):,} examples", 0, 1)
    network = make_network(arguments.hidden, arguments.seed)
    if number:
        take_over(network, _policy_file(folder, number - 1))
    result: Fit = fit(
        network,
        observations,
        actions,
        epochs=arguments.epochs,
        learning_rate=arguments.learning_rate,
        batch=arguments.batch,
        seed=arguments.seed + number,
    )
    save_driver(file, network)
    line = {"examples": len(actions), "loss": result.loss, "accuracy": list(result.accuracy)}
    with atomic_write(facts) as part:
        part.write_text(json.dumps(line) + "\n")
    return line


def _policy_file(folder: Path, number: int) -> Path:
    return folder / f"policy-{number:02d}.safetensors"


def _finish(arguments: Arguments, folder: Path) -> None:
    """The last round's policy as the run's, and as an agent."""
    network = make_network(arguments.hidden, arguments.seed)
    take_over(network, _policy_file(folder, arguments.rounds))
    save_driver(folder / _POLICY, network)
    write_agent(folder / "agent", network, f"{arguments.teacher}'s pupil")


# ------------------------------------------------------------------ what is shown


def plot_log(log: Sequence[dict[str, Any]], output: Path) -> None:
    """Draws the time ratio and the share that finished, round by round.

    Raises:
        ConfigError: matplotlib is missing.
    """
    from stkzoo.evaluation.plotting import (
        BLUE,
        GREY,
        INK,
        new_figure,
        save_figure,
        style_axes,
    )

    figure = new_figure(8, 3.6)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    teacher, *rounds = log
    places = list(range(len(rounds)))
    names = ["cloning", *(f"DAgger {n}" for n in places[1:])]
    left.errorbar(
        places,
        [line["time_ratio"] for line in rounds],
        yerr=[1.96 * line["error"] for line in rounds],
        color=BLUE,
        marker="o",
        capsize=3,
    )
    left.axhline(teacher["time_ratio"], color=GREY, linestyle="--", linewidth=1)
    left.text(
        places[-1], teacher["time_ratio"], teacher["driver"], color=GREY, ha="right", va="bottom"
    )
    left.set_title("time over the AI's median time", fontsize=10, color=INK, loc="left")
    right.bar(places, [100 * line["finished"] for line in rounds], color=BLUE, width=0.6)
    right.set_ylim(0, 100)
    right.set_title("karts that finished [%]", fontsize=10, color=INK, loc="left")
    for axis in (left, right):
        axis.set_xticks(places, names, rotation=30, ha="right")
        style_axes(axis)
        axis.grid(axis="y", color=GREY, alpha=0.25, linewidth=0.6)
        axis.set_axisbelow(True)
    save_figure(figure, output)


def _shown(line: dict[str, Any]) -> str:
    text = (
        f"{line['driver']}: time ratio {line['time_ratio']:.3f} +- {1.96 * line['error']:.3f}, "
        f"{line['finished']:.0%} of {line['karts']} karts finished"
    )
    if "examples" in line:
        steer = line["accuracy"][0]
        text += f"; then learned from {line['examples']:,} examples: steering right in {steer:.0%}"
    return text


class _Bar:
    """How far a stage is: a bar on a terminal, a line a stage elsewhere."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

        console = Console(stderr=True)
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bars.add_task("", total=1)
        self._is_quiet, self._what = not console.is_terminal, ""

    def __enter__(self) -> _Bar:
        self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._bars.stop()

    def tell(self, what: str, done: int, total: int) -> None:
        """Moves the bar."""
        if self._is_quiet and what != self._what:
            print(what, file=sys.stderr, flush=True)
        self._what = what
        self._bars.update(self._task, description=what, completed=done, total=total)


def parse(words: list[str] | None = None) -> tuple[Arguments, Path]:
    """Reads the command line.

    Raises:
        ConfigError: an argument cannot be.
    """
    parser = argparse.ArgumentParser(
        prog="python -m stkzoo.agents.training.imitation.imitate",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--output", type=Path, required=True, help="the run's folder")
    add_arguments(parser, Arguments)
    found = vars(parser.parse_args(words))
    folder = found.pop("output")
    return Arguments(**values_of(found)), folder


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    try:
        arguments, folder = parse(words)
        with _Bar() as bar:
            log = run(arguments, folder, bar.tell)
        for line in log:
            print(_shown(line))
        plot_log(log, folder / _PICTURE)
    except StkzooError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; the same command goes on", file=sys.stderr)
        return 130
    print(f"more in {folder}: {_POLICY}, {_PICTURE}, agent; try: stkzoo race {folder / 'agent'} ai")
    return 0


if __name__ == "__main__":
    sys.exit(main())
