"""Arguments that several training scripts share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar

from stkzoo._arguments import option
from stkzoo.errors import ConfigError, check_number, check_whole, unknown_name
from stkzoo.tracks import SPLITS, TRAIN_TRACKS

#: Title of a group of options.
_LEARNING = "learning"
#: The training tracks except one on which a race takes three times as long.
QUICK_TRACKS = tuple(track for track in TRAIN_TRACKS if track != "black_forest")


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

    #: Integers that may be 0.
    may_be_zero: ClassVar[tuple[str, ...]] = ("seed",)
    #: Lowest values of integers that must be above 1.
    least: ClassVar[Mapping[str, int]] = {}
    #: Highest values of integers; of seeds, the highest that all libraries accept.
    most: ClassVar[Mapping[str, int]] = {"difficulty": 3, "seed": 2**32 - 1}
    #: Numbers from 0 to 1, and other numbers that may be 0; all others must be above 0.
    fractions: ClassVar[tuple[str, ...]] = ()
    coefficients: ClassVar[tuple[str, ...]] = ()
    #: Number of hidden layers; ``None`` for any.
    num_layers: ClassVar[int | None] = None
    #: Fields in which names of splits, such as ``train_only``, are replaced with their tracks.
    track_fields: ClassVar[tuple[str, ...]] = ("tracks", "evaluation_tracks")

    seed: int = 0

    def __post_init__(self) -> None:
        for entry in fields(self):
            if entry.name in self.track_fields:
                object.__setattr__(self, entry.name, track_names(getattr(self, entry.name)))
            if type(entry.default) is int:
                least = self.least.get(entry.name, int(entry.name not in self.may_be_zero))
                most = self.most.get(entry.name)
                check_whole(entry.name, getattr(self, entry.name), least, most)
            elif type(entry.default) is float:
                self._check_float(entry.name, getattr(self, entry.name))
            elif entry.name == "hidden":
                self._check_hidden(getattr(self, entry.name))

    def _check_float(self, name: str, value: float) -> None:
        if name in self.fractions:
            check_number(name, value, 0, 1)
        elif name not in self.coefficients:
            check_number(name, value)
        elif not 0 <= value < math.inf:
            raise ConfigError(f"{name} is {value!r}, expected a number of 0 or more")

    def _check_hidden(self, hidden: Sequence[int]) -> None:
        for units in hidden:
            check_whole("hidden", units, 1)
        if self.num_layers not in (None, len(hidden)):
            raise ConfigError(
                f"hidden is {tuple(hidden)}, expected {self.num_layers} layers, such as 256 128"
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

    least: ClassVar[Mapping[str, int]] = {"batch_size": 2}  # advantages are normalized
    fractions: ClassVar[tuple[str, ...]] = ("gamma", "gae_lambda")
    coefficients: ClassVar[tuple[str, ...]] = ("ent_coef",)

    gamma: float = option(0.98, metavar="X", group=_LEARNING)
    gae_lambda: float = option(0.95, metavar="X", group=_LEARNING)
    clip_range: float = option(0.2, metavar="X", group=_LEARNING)
    ent_coef: float = option(0.0, metavar="X", group=_LEARNING)


@dataclass(frozen=True, slots=True)
class OverlappedArguments(PPOArguments):
    """Arguments of every script whose actors keep driving while it learns.

    Attributes:
        actors: number of processes that drive the races; 0 is one for each processor core.
            Results depend on their number.
        on_policy: drive each rollout with the latest networks. By default, the actors drive the
            next rollout during an update, with the networks before it.
        n_steps: steps of each race between two updates.
        anneal_timesteps: kart-steps over which learning rate and entropy coefficient decay.
        target_kl: KL divergence at which an update stops early.
        warm_up: iterations at the start that train only the value network.
        keep_every: kart-steps between two saved policies.
        checkpoint_every: iterations between two checkpoints.
    """

    may_be_zero: ClassVar[tuple[str, ...]] = ("seed", "warm_up", "actors")

    batch_size: int = 4096
    n_epochs: int = 3
    actors: int = 0
    on_policy: bool = False
    n_steps: int = 128
    anneal_timesteps: int = 20_000_000
    target_kl: float = 0.02
    warm_up: int = 10
    keep_every: int = 500_000
    checkpoint_every: int = 20


def track_names(names: Sequence[str]) -> tuple[str, ...]:
    """Replaces the names of splits, such as ``train``, with their tracks.

    Raises:
        ConfigError: a name is unknown.
    """
    for name in names:
        if name not in SPLITS and name not in SPLITS["all"]:
            raise unknown_name("track", name, [*SPLITS["all"], *SPLITS])
    return tuple(track for name in names for track in SPLITS.get(name, (name,)))
