r"""Teaches one network what the plans of the learned drivers would do, by DAgger.

    python -m stkzoo.agents.training.imitation.distill --output runs/distil
    python -m stkzoo.agents.training.sb3.selfplay --output runs/play --hold 1 \
        --start runs/distil/policy.safetensors

The plans weigh what may come in the next two seconds; the network sees the view ``racing`` and what
its action filter remembers, and answers at once. In the first round the plans drive, then the
network does, while the plans say what they would do where it got to (DAgger: Ross, Gordon and
Bagnell, 2011). Each round it learns from all that was seen so far, and drives every track once
alone.

In the folder: ``policy.safetensors``, ``agent`` (`stkzoo race runs/distil/agent ai`), ``log.jsonl``
and the rounds' lessons. A killed run goes on with its round when the same command is given again.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._os import atomic_write
from stkzoo.agents.planning import BRAKE as BRAKE_PLAN
from stkzoo.agents.planning import PolicyInput
from stkzoo.agents.pretrained.action_filter import INPUT_SIZE, steering
from stkzoo.agents.pretrained.mlp import MlpDriver
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.errors import StkzooError, check_whole
from stkzoo.tracks import TRAIN_TRACKS
from stkzoo.wrappers.racing import BRAKE

from ..common.arguments import RunBar, add_arguments, keep_arguments, training_torch, values_of
from ..common.fleet import Finish, Fleet, RaceForm
from ..common.network_karts import NetworkKarts, seen_by_networks
from ..common.training_log import read_log, write_log
from ..sb3.policy import save_driver, write_agent
from .network import fit, make_network, take_over

__all__ = ["Arguments", "Class", "main", "run"]

IntArray = npt.NDArray[np.int64]
Numbers = npt.NDArray[Any]

_POLICY = "policy.safetensors"
#: Alone, against others, and against the game's AI.
_FORMS = [
    *[RaceForm(1, 0)] * 8,
    *[RaceForm(5, 0)] * 4,
    *[RaceForm(2, 3)] * 4,
    *[RaceForm(1, 4)] * 4,
]
#: Drifts end when the plans say so.
_HOLD = 1
#: Who does not finish counts as being so much slower than the game's AI.
_UNFINISHED = 1.6


@dataclass(frozen=True, slots=True)
class Arguments:
    """What a run is made of.

    Attributes:
        rounds: how many.
        steps: kart-steps of each.
        tracks: both ways.
        hidden: units of the layers.
        epochs: how often a round goes over all lessons.
        last_epochs: how often the last round does.
        batch: lessons of a gradient.
        learning_rate: of Adam, at a round's start.
        seed: of everything.
    """

    rounds: int = 8
    steps: int = 60_000
    tracks: tuple[str, ...] = tuple(track for track in TRAIN_TRACKS if track != "black_forest")
    hidden: tuple[int, ...] = (256, 128)
    epochs: int = 4
    last_epochs: int = 12
    batch: int = 1024
    learning_rate: float = 1.5e-3
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("rounds", "steps", "epochs", "last_epochs", "batch"):
            check_whole(name, getattr(self, name), 1)


class Class:
    """Races in which pupils drive while the plans say what they would do.

    Args:
        fleet: the races, none of them mirrored.
        view: what is seen first.
    """

    def __init__(self, fleet: Fleet, view: PolicyInput) -> None:
        self.fleet, self.view = fleet, view
        self._plans = RacingPolicy.of_plans_alone()
        self._karts = NetworkKarts(fleet, _HOLD)

    @property
    def seen(self) -> Numbers:
        """What the pupils see, ``(S, 177)``."""
        return seen_by_networks(self.view)

    def answers(self) -> IntArray:
        """What the plans would do, as the pupils' choices ``(S, 5)``."""
        drivers, choices = self.fleet.drivers, self._plans.best(self.view)
        side, turn = drivers.moves(choices)
        begins = (side != 0) & (drivers.memory.situation().drift_side == 0)
        columns = (
            steering(side, turn, begins),
            np.where(choices[:, 0] == BRAKE_PLAN, BRAKE, 0),
            side != 0,
            *choices[:, 2:].T,
        )
        return np.stack(columns, axis=1).astype(np.int64)

    def step(self, choices: IntArray) -> list[Finish]:
        """Drives on by choices ``(S, 5)``; whose race ended."""
        self._karts.send(self.view, choices)
        self.view, outcome = self.fleet.receive()
        return outcome.finishes


def run(arguments: Arguments, folder: Path, bar: RunBar | None = None) -> list[dict[str, Any]]:
    """Teaches, or goes on with that.

    Args:
        arguments: of the run.
        folder: the run's.
        bar: shows how far it is.

    Returns:
        The log, a line a round: who drove, the loss [nats], the share of right choices, and the
        time ratio of the network's likeliest choices, alone on each track.

    Raises:
        ConfigError: torch is missing, or the folder has another run.
    """
    training_torch()
    keep_arguments(folder, arguments)
    log = read_log(folder)
    network = make_network(arguments.hidden, arguments.seed, INPUT_SIZE)
    if log:
        take_over(network, folder / _POLICY)
    for number in range(len(log), arguments.rounds):
        log.append(_round(arguments, folder, network, number, bar))
        save_driver(folder / _POLICY, network, _HOLD)
        write_log(folder, log)
    write_agent(folder / "agent", network, "pupil of the plans", _HOLD)
    return log


def _round(
    arguments: Arguments, folder: Path, network: Any, number: int, bar: RunBar | None
) -> dict[str, Any]:
    """Drives, learns and looks what came of it: its line of the log."""
    pupil = _driver(network) if number else None
    driven = _drive(arguments, pupil, number, folder, bar)
    lessons = [np.load(_lessons(folder, n)) for n in range(number + 1)]
    seen, answers = (np.concatenate([one[key] for one in lessons]) for key in ("seen", "answers"))
    is_last = number == arguments.rounds - 1
    result = fit(
        network,
        seen,
        answers,
        epochs=arguments.last_epochs if is_last else arguments.epochs,
        learning_rate=arguments.learning_rate,
        batch=arguments.batch,
        seed=arguments.seed + number,
    )
    alone = _alone(arguments, _driver(network))
    line = {
        "round": number,
        "driver": "the network" if number else "the plans",
        "driver_time_ratio": _mean_ratio(driven),
        "lessons": len(answers),
        "loss": result.loss,
        "accuracy": list(result.accuracy),
        "time_ratio_alone": _mean_ratio(alone),
        "unfinished": sum(finish.ratio is None for finish in alone),
    }
    if bar:
        bar.show((number + 1) * arguments.steps, _shown(line))
    return line


def _drive(
    arguments: Arguments, pupil: MlpDriver | None, number: int, folder: Path, bar: RunBar | None
) -> list[Finish]:
    """Collects a round's lessons; how the races went."""
    fleet = Fleet(_FORMS, arguments.tracks, arguments.seed + 1000 * number, mirrors=False)
    random = np.random.default_rng([arguments.seed, number])
    finishes: list[Finish] = []
    seen, answers, count = [], [], 0
    try:
        lesson = Class(fleet, fleet.begin())
        while count < arguments.steps:
            right, sees, active = lesson.answers(), lesson.seen, fleet.active
            seen.append(sees[active])
            answers.append(right[active])
            count += int(active.sum())
            choices = right
            if pupil:
                choices = pupil.best(sees) if number % 2 else pupil.sample(sees, random)
            finishes += lesson.step(choices)
            if bar:
                bar.show(number * arguments.steps + count, f"round {number} drives")
    finally:
        fleet.close()
    with atomic_write(_lessons(folder, number)) as part, part.open("wb") as file:
        np.savez_compressed(
            file, seen=np.concatenate(seen), answers=np.concatenate(answers).astype(np.int8)
        )
    return finishes


def _alone(arguments: Arguments, pupil: MlpDriver) -> list[Finish]:
    """How the likeliest choices drive each track both ways, alone."""
    places = [(track, reverse, 0) for track in arguments.tracks for reverse in (False, True)]
    fleet = Fleet([RaceForm(1, 0)] * len(places), arguments.tracks, 0, goes_on=False, mirrors=False)
    finishes: list[Finish] = []
    try:
        lesson = Class(fleet, fleet.begin_at(places))
        while fleet.active.any():
            finishes += lesson.step(pupil.best(lesson.seen))
    finally:
        fleet.close()
    return finishes


def _mean_ratio(finishes: Sequence[Finish]) -> float:
    ratios = [_UNFINISHED if finish.ratio is None else finish.ratio for finish in finishes]
    return round(float(np.mean(ratios)), 4) if ratios else _UNFINISHED


def _driver(network: Any) -> MlpDriver:
    return MlpDriver({name: value.numpy() for name, value in network.state_dict().items()})


def _lessons(folder: Path, number: int) -> Path:
    return folder / f"lessons-{number:02d}.npz"


def _shown(line: dict[str, Any]) -> str:
    return (
        f"round {line['round']}: {line['lessons']:,} lessons, loss {line['loss']:.2f}, "
        f"alone {line['time_ratio_alone']:.3f} of the AI's time, {line['unfinished']} unfinished"
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m stkzoo.agents.training.imitation.distill",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--output", type=Path, required=True, help="the run's folder")
    add_arguments(parser, Arguments)
    return parser


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    options = vars(_parser().parse_args(words))
    folder = options.pop("output")
    bar = None
    try:
        arguments = Arguments(**values_of(options))
        bar = RunBar(arguments.rounds * arguments.steps)
        log = run(arguments, folder, bar)
    except StkzooError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; the same command goes on with its round", file=sys.stderr)
        return 130
    finally:
        if bar:
            bar.stop()
    for line in log:
        print(_shown(line))
    print(f"stkzoo race {folder / 'agent'} ai ai --track lighthouse")
    return 0


if __name__ == "__main__":
    sys.exit(main())
