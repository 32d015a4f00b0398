r"""Distills the plans of the learned drivers into one network, with DAgger.

    python -m stkzoo.agents.training.imitation.distill --output runs/distill
    python -m stkzoo.agents.training.sb3.selfplay --output runs/play --hold 1 \
        --init runs/distill/policy.safetensors

The plans weigh the next two seconds. The network sees the view ``racing`` and the memory of its
action filter, and acts without planning. In the first round the plans drive; afterwards the network
drives, and the plans label the states that it visits with the action they would take (DAgger: Ross,
Gordon and Bagnell, 2011). In each round the network learns from all labels so far and then drives
every track once, alone.

The folder contains ``policy.safetensors``, ``agent`` (`stkzoo race runs/distill/agent ai`),
``log.jsonl``, ``imitation.png`` and the data of the rounds. To continue a run that was killed, run
the same command again; it repeats the interrupted round.
"""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo._arguments import option
from stkzoo.agents.planning import IntArray
from stkzoo.agents.planning.driver import PolicyInput
from stkzoo.agents.planning.plans import BRAKE as BRAKE_PLAN
from stkzoo.agents.planning.view import PlanVectorEnv
from stkzoo.agents.pretrained.action_filter import INPUT_SIZE, ActionFilter, steering
from stkzoo.agents.pretrained.mlp import MlpDriver, load_driver
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.wrappers.racing import BRAKE, SIZE, controls_of_choices

from ..common.arguments import QUICK_TRACKS, ScriptOptions
from ..common.command import run_command, training_torch
from ..common.matches import Match, ai_time, network_driver, play_matches
from .lessons import ImitationArguments, Lesson, Numbers, Report, run_rounds, show_rounds

#: Learners, bots and number of races: alone, against each other, and against the game's AI.
_LINEUPS = ((1, 0, 8), (5, 0, 4), (2, 3, 4), (1, 4, 4))
#: Minimum steps of a drift; with 1, drifts end when the plans end them.
_HOLD = 1
#: Time ratio of a kart that does not finish, and steps after which a race is cut short.
_UNFINISHED, _MAX_CYCLES = 1.6, 1200


@dataclass(frozen=True, slots=True)
class DistillationArguments(ImitationArguments):
    """Arguments of a run.

    Attributes:
        steps: kart-steps of each round.
        tracks: names of tracks or of splits, such as train_only; driven in both directions.
    """

    batch_size: int = 1024
    learning_rate: float = 1.5e-3
    rounds: int = 7
    steps: int = 60_000
    tracks: tuple[str, ...] = option(QUICK_TRACKS, flag="--track", metavar="TRACK")


class LabelledRaces:
    """Races in which students drive and the plans label their states.

    Args:
        races: the races.
        seed: seed of the races.

    Attributes:
        ratios: time over the AI's median time of each kart that has ended.
        finished: number of these karts that finished.
    """

    def __init__(self, races: PlanVectorEnv, seed: int) -> None:
        self.races, self.ratios, self.finished = races, list[float](), 0
        self._plans = RacingPolicy.of_plans_alone()
        self._action_filter = ActionFilter(races.num_envs, _HOLD, races.view.driver.memory)
        self._observations: dict[str, Numbers]
        self._observations, _ = races.reset(seed=seed)

    @property
    def seen(self) -> Numbers:
        """Inputs of the students, ``(S, 177)``."""
        return self._observations["inputs"][:, :INPUT_SIZE]

    def labels(self) -> IntArray:
        """Choices of the plans, in the students' form, ``(S, 5)``."""
        driver = self.races.view.driver
        choices = self._plans.best(PolicyInput(**self._observations))
        side, turn = driver.moves(choices)
        side_before, _, _ = driver.memory.drifts()
        begins = (side != 0) & (side_before == 0)
        columns = (
            steering(side, turn, begins),
            np.where(choices[:, 0] == BRAKE_PLAN, BRAKE, 0),
            side != 0,
            *choices[:, 2:].T,
        )
        return np.stack(columns, axis=1).astype(np.int64)

    def step(self, choices: IntArray) -> None:
        """Steps with choices ``(S, 5)``."""
        self._action_filter.see(self._observations["inputs"][:, :SIZE])
        facts = [race.race for race in self.races.races.races]
        self.races.send_controls(controls_of_choices(self._action_filter.apply(choices)))
        self._observations, _, finished, cut, infos = self.races.step_wait()
        for slot in np.flatnonzero(finished | cut).tolist():
            race = facts[slot // self.races.races.num_agents]
            median = ai_time(race.track, race.reverse, race.difficulty)
            time = float(infos["final_info"]["finish_time"][slot])
            self.ratios.append(time / median if finished[slot] else _UNFINISHED)
            self.finished += bool(finished[slot])


def run(
    arguments: DistillationArguments, folder: Path, report: Report = lambda *_: None
) -> list[dict[str, Any]]:
    """Starts or continues a distillation.

    Args:
        arguments: arguments of the run.
        folder: folder of the run.
        report: called with the current stage, the work done, and the total work.

    Returns:
        The log; see :func:`.lessons.run_rounds`. It includes each round's time ratio of the
            network's most likely choices, alone on each track, and how often it did not finish.

    Raises:
        ConfigError: torch is not installed, or the folder contains another run.
    """
    training_torch()
    return run_rounds(
        arguments,
        folder,
        "the plans",
        lambda number, policy: _drive(arguments, number, policy, report),
        report,
        inputs=INPUT_SIZE,
        hold=_HOLD,
        judge=lambda student: _alone(arguments, student),
    )


def _drive(
    arguments: DistillationArguments, number: int, policy: Path | None, report: Report
) -> Lesson:
    """Collects the data of a round."""
    student = load_driver(policy) if policy else None
    random = np.random.default_rng([arguments.seed, number])
    slots, seen, answers, count = [], [], [], 0
    with ExitStack() as resources:
        groups = []
        for offset, lineup in enumerate(_LINEUPS):
            envs = _races(arguments, *lineup)
            resources.callback(envs.close)
            groups.append(LabelledRaces(envs, arguments.seed + 1000 * number + 100 * offset))
        while count < arguments.steps:
            first = 0
            for group in groups:
                right, sees, active = group.labels(), group.seen, group.races.races.racing
                slots.append(first + np.flatnonzero(active))
                seen.append(sees[active])
                answers.append(right[active])
                first, count = first + len(active), count + int(active.sum())
                choices = right
                if student:
                    choices = student.best(sees) if number % 2 else student.sample(sees, random)
                group.step(choices)
            report(f"round {number} drives", count, arguments.steps)
    ratios = tuple(ratio for group in groups for ratio in group.ratios)
    finished = sum(group.finished for group in groups)
    by_kart = np.argsort(np.concatenate(slots), kind="stable")  # held-out blocks are of one kart
    inputs, labels = (np.concatenate(rows)[by_kart] for rows in (seen, answers))
    # Perhaps no race has finished.
    return Lesson(inputs, labels, ratios or (_UNFINISHED,), finished)


def _races(arguments: DistillationArguments, learners: int, bots: int, races: int) -> PlanVectorEnv:
    return PlanVectorEnv(
        races,
        num_kart=learners + bots,
        agents=learners,
        track=arguments.tracks,
        reverse=None,
        difficulty=arguments.difficulty,
        max_cycles=_MAX_CYCLES,
        num_starts=2 * len(arguments.tracks),
        start_seed=arguments.seed,
        skip_countdown=True,
    )


def _alone(arguments: DistillationArguments, student: MlpDriver) -> dict[str, float]:
    """Evaluates the most likely choices, alone on each track in both directions."""
    matches = [
        Match(("student",), track, reverse, bots=0, difficulty=arguments.difficulty)
        for track in arguments.tracks
        for reverse in (False, True)
    ]
    played = play_matches(matches, {"student": network_driver(student.best, _HOLD)})
    finishes = [finish for (finish,) in played]
    ratios = [_UNFINISHED if finish.ratio is None else finish.ratio for finish in finishes]
    return {
        "time_ratio_alone": round(float(np.mean(ratios)), 4),
        "unfinished": sum(finish.ratio is None for finish in finishes),
    }


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    kinds, show = (ScriptOptions, DistillationArguments), partial(show_rounds, run)
    remedy = "the same command continues with its round"
    return run_command("imitation.distill", __doc__, show, kinds, words, remedy)


if __name__ == "__main__":
    sys.exit(main())
