"""Trains a policy over plans by self-play with PPO, in many parallel races.

    python -m stkzoo.agents.training.ppo.selfplay --output runs/first --total-timesteps 2000000

One policy drives all karts of many races, against itself and against the game's AI, and is trained
with proximal policy optimization (Schulman et al., 2017). A small network sees the racing view
(:mod:`stkzoo.wrappers.racing`), the driver's memory, and the values of plans for the next two
seconds (:mod:`stkzoo.agents.planning`). It chooses which maneuver to begin, nitro and fire, and
optionally a steering offset from the plan. Training starts from the driver that takes the best
plan. Half of the karts, drawn for each race, drive mirrored left to right. The reward is the
distance driven along the track plus places gained. The return does not end at the finish, so that
karts do not slow down before it.

To continue a run, also after a kill, run the same command again, perhaps with more
``--total-timesteps``. The run continues bit for bit, because all races restart after a checkpoint.
The folder contains ``checkpoint.pt``, ``log.jsonl`` (one line per iteration), TensorBoard files,
``arguments.json``, and ``policy-STEPS.safetensors``, which ``python -m
stkzoo.agents.training.export`` converts to an agent.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._arguments import option
from stkzoo._os import cpu_count
from stkzoo._schema import Share
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.errors import check_whole

from ..common.actors import ActorPool, SharedArray
from ..common.arguments import QUICK_TRACKS, Coefficient, OverlappedArguments, ScriptOptions
from ..common.command import run_command
from ..common.fleet import Finish
from ..common.learner import RunFacts, train
from ..common.ppo import OverlappedPPO
from ..common.run_folder import plan_parameters
from ..common.starts import Lineup, parse_races
from .network import ActorCritic, initial_weights
from .rollouts import ROLLOUT, ActorArguments, RaceActor

# ---------------------------------------------------------------------- arguments


@dataclass(frozen=True, slots=True)
class SelfPlayArguments(OverlappedArguments):
    """Arguments of a run; they must not change when a run continues.

    Attributes:
        tracks: tracks or splits to train on, such as train_only.
        races: parallel races: 8x5 is five races of eight learners, 4+2x3 three races of four
            learners and two karts of the game's AI at its highest difficulty.
        plans: JSON file of plan parameters, such as best.json of tune_plans; empty is the default.
        turn_hold: steps for which a steering offset holds; with 1, the policy chooses it in every
            step. None is as in plans.
        kl_coef: coefficient of the KL penalty toward the plans' prior.
        learns: choices to train; the others stay those of the plans. With --init, the others change
            too, because all choices of a policy share its hidden layers.
        place_reward: reward per place; the reward per meter is 0.05.
        init: policy file to start from; empty starts from the plans.
    """

    hidden: tuple[int, int] = (256, 128)
    gae_lambda: Share = 0.85
    tracks: tuple[str, ...] = option(QUICK_TRACKS, flag="--track", metavar="TRACK")
    races: tuple[str, ...] = ("1x8", "5x8", "2+3x8", "1+4x8")
    plans: str = ""
    turn_hold: int | None = None
    kl_coef: Coefficient = 5e-3
    learns: tuple[str, ...] = ("begin", "nitro", "fire")
    place_reward: Coefficient = 0.1
    init: str = ""


# ---------------------------------------------------------------------- the algorithm


@dataclass(frozen=True, slots=True)
class LearnerFacts(RunFacts):
    """The facts in a checkpoint.

    Attributes:
        recent: the latest finishes.
    """

    recent: tuple[Finish, ...]


class PPOLearner(OverlappedPPO):
    """A run of self-play over plans; see :class:`..common.ppo.OverlappedPPO`.

    Args:
        folder: folder of the run.
        arguments: arguments of the run.
        may_change: whether to continue even if the run had other arguments.

    Raises:
        ConfigError: the folder contains a run with other arguments, or an argument is invalid.
    """

    remedy = ", or --may-change to continue with these"
    arguments: SelfPlayArguments

    def __init__(
        self, folder: str | Path, arguments: SelfPlayArguments, *, may_change: bool = False
    ) -> None:
        self._plan_rules = _plan_rules(arguments)
        self._lineups = parse_races(arguments.races)
        super().__init__(folder, arguments, LearnerFacts, may_change=may_change)

    def _new_network(self) -> ActorCritic:
        given = self.arguments
        return ActorCritic(given.hidden, given.seed, given.learns, given.kl_coef)

    def _first_network(self) -> ActorCritic:
        network, init = self._new_network(), self.arguments.init
        if init:
            network.start_from(initial_weights(init, self.arguments.hidden))
        return network

    def _start_actors(self) -> tuple[ActorPool, list[npt.NDArray[np.void]]]:
        arguments, lineups = self.arguments, self._lineups
        count = min(arguments.actors or cpu_count(), len(lineups))
        shares = [
            ActorArguments(
                lineups=tuple(lineups[number::count]),
                tracks=arguments.tracks,
                place_reward=arguments.place_reward,
                rules=self._plan_rules,
                learns=arguments.learns,
            )
            for number in range(count)
        ]
        memories = [
            SharedArray((2, arguments.n_steps, share.num_slots), ROLLOUT) for share in shares
        ]
        actors = self._new_actors(list(zip(shares, memories, strict=True)))
        return actors, [memory.array() for memory in memories]

    def _new_actors(self, arguments: Sequence[tuple[ActorArguments, SharedArray]]) -> ActorPool:
        return ActorPool(RaceActor, arguments)

    def _rules(self) -> dict[str, Any]:
        return asdict(self._plan_rules)

    def _figures(self) -> dict[str, float]:
        figures = {}
        for name in ("alone", "selfplay", "rivals"):
            own = [end for end in self._recent if _company(end.lineup) == name]
            if not own:
                continue
            finished = [end.ratio for end in own if end.ratio is not None]
            figures[f"{name}_ratio"] = float(np.mean([end.counted_ratio for end in own]))
            figures[f"{name}_finished_ratio"] = float(np.mean(finished)) if finished else 0.0
            figures[f"{name}_unfinished"] = 1.0 - len(finished) / len(own)
            if name == "rivals":
                figures["rivals_rank"] = float(np.mean([end.rank for end in own]))
                figures["rivals_first"] = float(np.mean([end.rank == 1 for end in own]))
        return figures


def _plan_rules(arguments: SelfPlayArguments) -> DriverParameters:
    """Returns the parameters of the plans."""
    rules, hold = plan_parameters(arguments.plans), arguments.turn_hold
    if hold is None:
        return rules
    return replace(rules, turn_hold=check_whole("turn_hold", hold, 1))


def _company(lineup: Lineup) -> str:
    """Returns which opponents the learners of a race meet."""
    return "rivals" if lineup.bots else "selfplay" if lineup.learners > 1 else "alone"


# ---------------------------------------------------------------------- the command


@dataclass(frozen=True, slots=True)
class SelfPlayOptions(ScriptOptions):
    """Options of the command.

    Attributes:
        total_timesteps: total kart-steps to train for.
        may_change: continue even if the arguments differ; arguments.json records both.
    """

    total_timesteps: int = option(required=True)
    may_change: bool = False


def _train(options: SelfPlayOptions, arguments: SelfPlayArguments) -> None:
    """Starts or continues a run.

    Raises:
        ConfigError: see :class:`PPOLearner`.
    """
    learner = PPOLearner(options.output, arguments, may_change=options.may_change)
    with closing(learner):
        train(learner, options.total_timesteps, _SHOWN)


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    kinds = SelfPlayOptions, SelfPlayArguments
    remedy = "the same command continues from the last checkpoint"
    return run_command("ppo.selfplay", __doc__, _train, kinds, words, remedy)


_SHOWN = (
    "alone_ratio",
    "selfplay_ratio",
    "rivals_ratio",
    "rivals_rank",
    "entropy",
    "kl",
    "explained",
)


if __name__ == "__main__":
    sys.exit(main())
