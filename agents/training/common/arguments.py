"""Arguments of the training scripts: what several share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar

from stkzoo._arguments import option
from stkzoo.errors import check_whole
from stkzoo.tracks import SPLITS, TRAIN_TRACKS

#: The training tracks but for one, on which a race takes three times as long.
QUICK_TRACKS = tuple(track for track in TRAIN_TRACKS if track != "black_forest")


@dataclass(frozen=True, slots=True)
class ScriptOptions:
    """Options of every script, which are not among the arguments of its run.

    Attributes:
        output: the run's folder.
    """

    output: Path = option(required=True)


@dataclass(frozen=True, slots=True)
class RunArguments:
    """Arguments of every script.

    Attributes:
        seed: seed of everything.

    Raises:
        ConfigError: a whole number is below 1, or below 0 where 0 has a meaning.
    """

    #: Whole numbers that may be 0.
    may_be_zero: ClassVar[tuple[str, ...]] = ("seed",)

    seed: int = 0

    def __post_init__(self) -> None:
        for entry in fields(self):
            if type(entry.default) is int:
                least = int(entry.name not in self.may_be_zero)
                check_whole(entry.name, getattr(self, entry.name), least)


@dataclass(frozen=True, slots=True)
class NetworkArguments(RunArguments):
    """Arguments of every script that trains a network.

    Attributes:
        hidden: units of the hidden layers.
        learning_rate: learning rate of Adam at the start.
        batch_size: samples of one gradient step.
        n_epochs: passes over the collected data per update.
    """

    hidden: tuple[int, ...] = (256, 128)
    learning_rate: float = 3e-4
    batch_size: int = 512
    n_epochs: int = 4


@dataclass(frozen=True, slots=True)
class PPOArguments(NetworkArguments):
    """Arguments of every script that trains with PPO, named as in Stable-Baselines3.

    Attributes:
        gamma: discount per step.
        gae_lambda: lambda of the generalised advantage estimate.
        clip_range: clipping range of the probability ratio.
        ent_coef: entropy coefficient at the start.
    """

    gamma: float = 0.98
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    ent_coef: float = 0.0


def track_names(names: Sequence[str]) -> list[str]:
    """Replaces the names of splits, such as ``train``, with their tracks."""
    return [track for name in names for track in SPLITS.get(name, (name,))]
