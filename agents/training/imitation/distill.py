r"""Distills the plans of the learned drivers into one network, by DAgger.

    python -m stkzoo.agents.training.imitation.distill --output runs/distill
    python -m stkzoo.agents.training.sb3.selfplay --output runs/play --hold 1 \
        --init runs/distill/policy.safetensors

The plans weigh the next two seconds; the network sees the view ``racing`` and what its action
filter remembers, and answers at once. In the first round the plans drive, then the network does,
and the plans label what it should have done where it got to (DAgger: Ross, Gordon and Bagnell,
2011). Each round it learns from all labels so far, and drives every track once alone.

In the folder: ``policy.safetensors``, ``agent`` (`stkzoo race runs/distill/agent ai`),
``log.jsonl`` and the rounds' lessons. The same command continues a run that was killed with the
round that was under way.
"""

from __future__ import annotations

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
from stkzoo.agents.pretrained.action_filter import INPUT_SIZE, ActionFilter, steering
from stkzoo.agents.pretrained.mlp import MlpDriver
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.errors import check_whole
from stkzoo.wrappers.racing import BRAKE, SIZE, controls_of_choices

from ..common.arguments import (
    QUICK_TRACKS,
    NetworkArguments,
    add_arguments,
    keep_arguments,
    values_of,
)
from ..common.command import ProgressBar, command_parser, run_command, training_torch
from ..common.fleet import Finish, Fleet, Lineup
from ..common.matches import Match, network_driver, play_matches
from ..common.network_policy import save_driver
from ..common.training_log import LOG, read_json_lines, write_log
from ..export import export_policy
from .network import fit, load_weights_into, make_network

IntArray = npt.NDArray[np.int64]
Numbers = npt.NDArray[Any]

_POLICY = "policy.safetensors"
#: Alone, against others, and against the game's AI.
_LINEUPS = [
    *[Lineup(1, 0)] * 8,
    *[Lineup(5, 0)] * 4,
    *[Lineup(2, 3)] * 4,
    *[Lineup(1, 4)] * 4,
]
#: Drifts end when the plans say so.
_HOLD = 1
#: The time ratio of a kart that does not finish.
_UNFINISHED = 1.6


@dataclass(frozen=True, slots=True)
class DistillationArguments(NetworkArguments):
    """Arguments of a run.

    Attributes:
        rounds: how many.
        steps: kart-steps of each round.
        tracks: driven in both directions.
        n_epochs_last: passes over all lessons in the last round.
    """

    batch_size: int = 1024
    learning_rate: float = 1.5e-3
    rounds: int = 8
    steps: int = 60_000
    tracks: tuple[str, ...] = QUICK_TRACKS
    n_epochs_last: int = 12

    def __post_init__(self) -> None:
        for name in ("rounds", "steps", "n_epochs", "n_epochs_last", "batch_size"):
            check_whole(name, getattr(self, name), 1)


class LabelledRaces:
    """Races in which students drive while the plans label what they should do.

    Args:
        fleet: the races, none of them mirrored.
        view: what is seen first.
    """

    def __init__(self, fleet: Fleet, view: PolicyInput) -> None:
        self.fleet, self.view = fleet, view
        self._plans = RacingPolicy.of_plans_alone()
        self._action_filter = ActionFilter(fleet.num_slots, _HOLD, fleet.drivers.memory)

    @property
    def seen(self) -> Numbers:
        """What the students see, ``(S, 177)``."""
        return self.view.inputs[:, :INPUT_SIZE]

    def labels(self) -> IntArray:
        """What the plans would do, as the students' choices ``(S, 5)``."""
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
        """Makes a step by choices ``(S, 5)``; the finishes of those whose race ended."""
        self._action_filter.see(self.view.inputs[:, :SIZE])
        self.fleet.send_controls(controls_of_choices(self._action_filter.apply(choices)))
        self.view, outcome = self.fleet.receive()
        return outcome.finishes


def run(
    arguments: DistillationArguments, folder: Path, bar: ProgressBar | None = None
) -> list[dict[str, Any]]:
    """Distills, or continues a run.

    Args:
        arguments: of the run.
        folder: the run's.
        bar: shows the progress.

    Returns:
        The log, one line per round: the driver, the loss [nats], the share of right choices, and
        the time ratio of the network's most likely choices, alone on each track.

    Raises:
        ConfigError: torch is not installed, or the folder has another run.
    """
    training_torch()
    keep_arguments(folder, arguments)
    log = read_json_lines(folder / LOG)
    network = make_network(arguments.hidden, arguments.seed, INPUT_SIZE)
    if log:
        load_weights_into(network, folder / _POLICY)
    for number in range(len(log), arguments.rounds):
        log.append(_round(arguments, folder, network, number, bar))
        save_driver(folder / _POLICY, network, _HOLD)
        write_log(folder, log)
    export_policy(folder / _POLICY, "student", folder / "agent")
    return log


def _round(
    arguments: DistillationArguments,
    folder: Path,
    network: Any,
    number: int,
    bar: ProgressBar | None,
) -> dict[str, Any]:
    """Drives, learns and evaluates; the round's line of the log."""
    student = _driver(network) if number else None
    driven = _drive(arguments, student, number, folder, bar)
    lessons = [np.load(_lessons(folder, n)) for n in range(number + 1)]
    seen, answers = (np.concatenate([one[key] for one in lessons]) for key in ("seen", "answers"))
    is_last = number == arguments.rounds - 1
    result = fit(
        network,
        seen,
        answers,
        n_epochs=arguments.n_epochs_last if is_last else arguments.n_epochs,
        learning_rate=arguments.learning_rate,
        batch_size=arguments.batch_size,
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
        bar.show((number + 1) * arguments.steps, _summary(line))
    return line


def _drive(
    arguments: DistillationArguments,
    student: MlpDriver | None,
    number: int,
    folder: Path,
    bar: ProgressBar | None,
) -> list[Finish]:
    """Collects a round's lessons; the finishes of its races."""
    fleet = Fleet(_LINEUPS, arguments.tracks, arguments.seed + 1000 * number, mirrors=False)
    random = np.random.default_rng([arguments.seed, number])
    finishes: list[Finish] = []
    seen, answers, count = [], [], 0
    try:
        lesson = LabelledRaces(fleet, fleet.begin())
        while count < arguments.steps:
            right, sees, active = lesson.labels(), lesson.seen, fleet.active
            seen.append(sees[active])
            answers.append(right[active])
            count += int(active.sum())
            choices = right
            if student:
                choices = student.best(sees) if number % 2 else student.sample(sees, random)
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


def _alone(arguments: DistillationArguments, student: MlpDriver) -> list[Finish]:
    """How the most likely choices drive each track in both directions, alone."""
    matches = [
        Match(("student",), track, reverse, bots=0)
        for track in arguments.tracks
        for reverse in (False, True)
    ]
    drivers = {"student": network_driver(student.best, _HOLD)}
    return [finish for (finish,) in play_matches(matches, drivers)]


def _mean_ratio(finishes: Sequence[Finish]) -> float:
    ratios = [_UNFINISHED if finish.ratio is None else finish.ratio for finish in finishes]
    return round(float(np.mean(ratios)), 4) if ratios else _UNFINISHED


def _driver(network: Any) -> MlpDriver:
    return MlpDriver({name: value.numpy() for name, value in network.state_dict().items()})


def _lessons(folder: Path, number: int) -> Path:
    return folder / f"lessons-{number:02d}.npz"


def _summary(line: dict[str, Any]) -> str:
    return (
        f"round {line['round']}: {line['lessons']:,} lessons, loss {line['loss']:.2f}, "
        f"alone {line['time_ratio_alone']:.3f} of the AI's time, {line['unfinished']} unfinished"
    )


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    parser = command_parser("imitation.distill", __doc__)
    parser.add_argument("--output", type=Path, required=True, help="the run's folder")
    add_arguments(parser, DistillationArguments)
    options = vars(parser.parse_args(words))
    folder = options.pop("output")

    def distill() -> None:
        arguments = DistillationArguments(**values_of(options))
        with ProgressBar(arguments.rounds * arguments.steps) as bar:
            log = run(arguments, folder, bar)
        for line in log:
            print(_summary(line))
        print(f"stkzoo race {folder / 'agent'} ai ai --track lighthouse")

    return run_command(distill, "the same command continues with its round")


if __name__ == "__main__":
    sys.exit(main())
