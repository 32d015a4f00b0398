"""Trains a policy over plans by self-play with PPO, in many parallel races.

    python -m stkzoo.agents.training.ppo.selfplay --output runs/first --total-timesteps 2000000

One policy drives all karts of many races, against itself and against the game's AI, and is trained
with proximal policy optimization (Schulman et al., 2017). A small network sees the racing view
(:mod:`stkzoo.wrappers.racing`), the driver's memory, and the values of plans for the next two
seconds (:mod:`stkzoo.agents.planning.view`). It chooses which maneuver to begin, nitro and fire,
and optionally a steering offset from the plan. Training starts from the driver that takes the best
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
from contextlib import closing
from dataclasses import dataclass
from functools import partial

from stkzoo import Reward
from stkzoo._arguments import option
from stkzoo._schema import Share
from stkzoo.agents.planning.driver import CHOICE_NAMES
from stkzoo.errors import ConfigError
from stkzoo.mdp import rewards

from ..common.arguments import (
    QUICK_TRACKS,
    Coefficient,
    Lineup,
    RolloutArguments,
    ScriptOptions,
    parse_races,
)
from ..common.command import run_command
from ..common.run_folder import plan_parameters
from .network import PlanNetwork, initial_weights
from .opponents import NOBODY, OPPONENTS, Matchmaker
from .rollouts import ActorRaces
from .run import PPORun, PPOSetup

#: Reward per meter.
_METER = 0.05

# ---------------------------------------------------------------------- arguments


@dataclass(frozen=True, slots=True)
class SelfPlayArguments(RolloutArguments):
    """Arguments of a run; they must not change when a run continues.

    Attributes:
        tracks: tracks or splits to train on, such as train_only; driven in both directions.
        races: parallel races: 8x5 is five races of eight learners, 4+2x3 three races of four
            learners and two karts of the game's AI at its highest difficulty.
        num_starts: number of different starts of each kind of race in each process. Races copy
            them in the moment of GO.
        max_cycles: steps after which a race is cut short.
        plans: JSON file of plan parameters (DriverParameters); empty is the default.
        kl_coef: coefficient of the KL penalty toward the plans' prior.
        learns: choices to train; the others stay those of the plans. With --init, the others change
            too, because all choices of a policy share its hidden layers.
        place_reward: reward per place; the reward per meter is 0.05.
        init: policy file to start from; empty starts from the plans.
        opponents: past selves that drive half of the karts in half of the races without the game's
            AI: none, fictitious (all equally often) or prioritized (those that are beaten least).
        pool_size: number of past selves to keep as opponents; keep_every determines their distance.
    """

    hidden: tuple[int, int] = (256, 128)
    n_epochs: int = 2
    gae_lambda: Share = 0.85
    tracks: tuple[str, ...] = option(QUICK_TRACKS, flag="--track", metavar="TRACK")
    races: tuple[str, ...] = ("1x8", "5x8", "2+3x8", "1+4x8")
    num_starts: int = 32
    max_cycles: int = 1200
    plans: str = ""
    kl_coef: Coefficient = 5e-3
    learns: tuple[str, ...] = ("begin", "nitro", "fire")
    place_reward: Coefficient = 0.1
    init: str = ""
    opponents: str = NOBODY
    pool_size: int = 40


# ---------------------------------------------------------------------- the run


def selfplay_setup(arguments: SelfPlayArguments) -> PPOSetup:
    """Returns what a run learns.

    Raises:
        ConfigError: an argument is invalid.
    """
    if arguments.opponents not in OPPONENTS:
        raise ConfigError(
            f"opponents is {arguments.opponents!r}, expected one of {', '.join(OPPONENTS)}"
        )
    columns = choice_columns(arguments.learns)
    make = partial(PlanNetwork, columns, arguments.hidden, arguments.seed, arguments.kl_coef)
    return PPOSetup(
        groups=tuple(_race_group(arguments, lineup) for lineup in parse_races(arguments.races)),
        make_network=make,
        read_first=partial(initial_weights, arguments.init, arguments.hidden)
        if arguments.init
        else None,
        plans=plan_parameters(arguments.plans),
        bootstraps_finish=True,  # so that karts do not slow down before the finish
        matchmaker=Matchmaker(arguments.opponents, arguments.pool_size),
    )


def _race_group(arguments: SelfPlayArguments, lineup: Lineup) -> ActorRaces:
    reward = Reward(
        {"meters": rewards.advance, "places": rewards.overtaking},
        {"meters": 10 * _METER, "places": arguments.place_reward},
    )
    options = {
        "num_kart": lineup.learners + lineup.bots,
        "agents": lineup.learners,
        "track": arguments.tracks,
        "reverse": None,
        "difficulty": 3,
        "reward": reward,
        "max_cycles": arguments.max_cycles,
        "num_starts": arguments.num_starts,
        "start_seed": arguments.seed,
        "skip_countdown": True,
    }
    return ActorRaces(lineup.races, options, has_rivals=lineup.has_duels)


def choice_columns(names: tuple[str, ...]) -> list[int]:
    """Returns the columns of choices by name.

    Raises:
        ConfigError: a name is unknown, or there is none.
    """
    unknown = sorted(set(names) - set(CHOICE_NAMES))
    if unknown or not names:
        raise ConfigError(f"learns is {list(names)}; expected some of {', '.join(CHOICE_NAMES)}")
    return sorted(CHOICE_NAMES.index(name) for name in set(names))


# ---------------------------------------------------------------------- the command


@dataclass(frozen=True, slots=True)
class SelfPlayOptions(ScriptOptions):
    """Options of the command.

    Attributes:
        total_timesteps: total kart-steps to train for.
    """

    total_timesteps: int = option(required=True)


def _train(options: SelfPlayOptions, arguments: SelfPlayArguments) -> None:
    """Starts or continues a run.

    Raises:
        ConfigError: see :class:`.run.PPORun`.
    """
    with closing(PPORun(options.output, arguments, selfplay_setup(arguments))) as run:
        run.learn(options.total_timesteps, _SHOWN)


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
