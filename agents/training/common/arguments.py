"""Arguments that several training scripts share."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

from msgspec import Meta

from stkzoo._arguments import option
from stkzoo._checks import check_number, check_whole, unknown_name
from stkzoo._schema import Share
from stkzoo.errors import ConfigError
from stkzoo.tracks import SPLITS, TRAIN_TRACKS

#: Title of a group of options.
_LEARNING = "learning"
#: The training tracks except one on which a race takes three times as long.
QUICK_TRACKS = tuple(track for track in TRAIN_TRACKS if track != "black_forest")

#: Types of numbers with their bounds. By default, whole numbers are at least 1, others above 0.
Natural = Annotated[int, Meta(ge=0)]
Coefficient = Annotated[float, Meta(ge=0)]
Seed = Annotated[int, Meta(ge=0, le=2**32 - 1)]  # up to the highest that all libraries accept
BatchSize = Annotated[int, Meta(ge=2)]  # advantages are normalized
_DEFAULT_BOUNDS = {int: Meta(ge=1), float: Meta(gt=0)}


@dataclass(frozen=True, slots=True)
class ScriptOptions:
    """Options of every script that are not part of its run's arguments.

    Attributes:
        output: folder of the run.
    """

    output: Path = option(required=True, metavar="FOLDER")


@dataclass(frozen=True, slots=True)
class RunArguments:
    """Arguments of every script.

    Attributes:
        seed: seed of all random numbers.

    Raises:
        ConfigError: a number is out of bounds, or a track does not exist.
    """

    seed: Seed = 0

    def __post_init__(self) -> None:
        hints = get_type_hints(type(self), include_extras=True)
        for entry in fields(self):
            value, hint = getattr(self, entry.name), hints[entry.name]
            if entry.name == "tracks":
                object.__setattr__(self, "tracks", track_names(value))
            elif entry.name == "hidden":
                _check_hidden(value, hint)
            elif type(entry.default) in _DEFAULT_BOUNDS:
                _check_bounds(entry.name, value, hint)


def _check_bounds(name: str, value: Any, hint: Any) -> None:
    """Checks a number against the bounds of its type."""
    number_type, bounds = get_args(hint) or (hint, _DEFAULT_BOUNDS[hint])
    if number_type is int:
        check_whole(name, value, bounds.ge, bounds.le)
    elif bounds.le is not None or bounds.gt is not None:
        check_number(name, value, high=bounds.le)
    elif not 0 <= value < math.inf:
        raise ConfigError(f"{name} is {value!r}, expected a number of 0 or more")


def _check_hidden(hidden: Sequence[int], hint: Any) -> None:
    """Checks the units of hidden layers. A type such as ``tuple[int, int]`` has their number."""
    for units in hidden:
        check_whole("hidden", units, 1)
    layers = get_args(hint)
    if ... not in layers and len(layers) != len(hidden):
        raise ConfigError(
            f"hidden is {tuple(hidden)}, expected {len(layers)} layers, such as 256 128"
        )


@dataclass(frozen=True, slots=True)
class NetworkArguments(RunArguments):
    """Arguments of every script that trains a network.

    Attributes:
        hidden: units of the hidden layers.
        learning_rate: initial learning rate of Adam.
        batch_size: samples per gradient step.
        n_epochs: passes over the collected data per update.
    """

    hidden: tuple[int, ...] = option((256, 128), group=_LEARNING)
    learning_rate: float = option(3e-4, metavar="X", group=_LEARNING)
    batch_size: int = option(512, group=_LEARNING)
    n_epochs: int = option(4, group=_LEARNING)


@dataclass(frozen=True, slots=True)
class PPOArguments(NetworkArguments):
    """Arguments of every script that trains with PPO, named as in Stable-Baselines3.

    Attributes:
        gamma: discount factor per step.
        gae_lambda: lambda of generalized advantage estimation (GAE).
        clip_range: clipping range of the probability ratio.
        ent_coef: initial entropy coefficient.
    """

    batch_size: BatchSize = 512
    gamma: Share = option(0.98, metavar="X", group=_LEARNING)
    gae_lambda: Share = option(0.95, metavar="X", group=_LEARNING)
    clip_range: float = option(0.2, metavar="X", group=_LEARNING)
    ent_coef: Coefficient = option(0.0, metavar="X", group=_LEARNING)


@dataclass(frozen=True, slots=True)
class LearnerArguments(PPOArguments):
    """Arguments of every script that trains one policy in this program.

    Attributes:
        n_steps: steps of each race between two updates.
        keep_every: kart-steps between two saved policies.
        checkpoint_every: iterations between two checkpoints.
    """

    n_steps: int = 128
    keep_every: int = 500_000
    checkpoint_every: int = 20


@dataclass(frozen=True, slots=True)
class RolloutArguments(LearnerArguments):
    """Arguments of every script whose actors keep driving while it learns.

    Attributes:
        actors: number of processes that drive the races; 0 is one for each processor core.
            Results depend on their number.
        on_policy: drive each rollout with the latest networks. By default, the actors drive the
            next rollout during an update, with the networks before it.
        anneal_timesteps: kart-steps over which learning rate and entropy coefficient decay.
        target_kl: KL divergence at which an update stops early.
        warm_up: iterations at the start that train only the value network.
    """

    batch_size: BatchSize = 4096
    n_epochs: int = 3
    actors: Natural = 0
    on_policy: bool = False
    anneal_timesteps: int = 20_000_000
    target_kl: float = 0.02
    warm_up: Natural = 10


#: Number of learners, of karts of the game's AI, and of races; see :func:`parse_races`.
_RACES = re.compile(r"([1-9]\d*)(?:\+(\d+))?(?:x([1-9]\d*))?")


@dataclass(frozen=True, slots=True)
class Lineup:
    """Number of learners and of karts of the game's AI in a race, and of races with them."""

    learners: int
    bots: int
    races: int = 1

    @property
    def has_duels(self) -> bool:
        """Whether a past self can drive half of the karts."""
        return self.learners > 1 and not self.bots


def parse_races(texts: Sequence[str]) -> list[Lineup]:
    """Parses ``4x3`` (three races of four learners) or ``2+2x1`` (two learners, two AI karts).

    Raises:
        ConfigError: a text has another form.
    """
    lineups = []
    for text in texts:
        if not (match := _RACES.fullmatch(text)):
            raise ConfigError(
                f"races {text!r} are invalid; expected for example 4x3 (three races of four "
                "agents) or 2+2x1 (one race of two agents and two karts of the game's AI)"
            )
        learners, bots, races = (int(number or 0) for number in match.groups())
        lineups.append(Lineup(learners, bots, races or 1))
    return lineups


def track_names(names: Sequence[str]) -> tuple[str, ...]:
    """Replaces the names of splits, such as ``train``, with their tracks.

    Raises:
        ConfigError: a name is unknown.
    """
    for name in names:
        if name not in SPLITS and name not in SPLITS["all"]:
            raise unknown_name("track", name, [*SPLITS["all"], *SPLITS])
    return tuple(track for name in names for track in SPLITS.get(name, (name,)))
