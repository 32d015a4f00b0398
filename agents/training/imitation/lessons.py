"""Lessons: examples from the races of a round, and how a network learns from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._arrays import read_arrays, write_arrays
from stkzoo._reading import reading
from stkzoo.wrappers.racing import CHOICES, MIRROR

from ..common.command import training_library, training_torch
from ..ppo.network import RacingNetwork

Numbers = npt.NDArray[Any]

#: Largest size of a lesson's file [bytes].
_MAX_BYTES = 8 << 30
#: Standard deviation of the label smoothing over neighboring steering choices [choices].
_BLUR = 0.7


@dataclass(frozen=True, slots=True)
class Lesson:
    """Data of a round's races: ``N`` moments of all karts together.

    Attributes:
        observations: ``(N, inputs)`` float32, inputs of the learner.
        actions: ``(N, 5)``, choices of the teacher.
        ratios: time of each kart over the AI's time; a worst case if it did not finish.
        finished: number of karts that finished.
    """

    observations: Numbers
    actions: Numbers
    ratios: tuple[float, ...]
    finished: int

    @classmethod
    def joined(cls, lessons: Sequence[Lesson]) -> Lesson:
        """Returns several lessons as one."""
        return cls(
            np.concatenate([lesson.observations for lesson in lessons]),
            np.concatenate([lesson.actions for lesson in lessons]),
            tuple(ratio for lesson in lessons for ratio in lesson.ratios),
            sum(lesson.finished for lesson in lessons),
        )

    def save(self, path: Path) -> None:
        """Writes the lesson to a file atomically."""
        arrays = {
            "observations": self.observations,
            "actions": self.actions.astype(np.int8),
            "ratios": np.array(self.ratios),
            "finished": np.array(self.finished),
        }
        write_arrays(path, arrays, "the lesson")

    @classmethod
    def load(cls, path: Path) -> Lesson:
        """Reads a file that :meth:`save` wrote.

        Raises:
            ConfigError: the file is damaged.
        """
        with reading(f"{path} is unreadable", "a round's lessons; delete it to drive it again"):
            arrays, _ = read_arrays(path, _MAX_BYTES)
            ratios, finished = tuple(arrays["ratios"].tolist()), int(arrays["finished"])
            return cls(arrays["observations"], arrays["actions"], ratios, finished)


def mirrored(observations: Numbers, actions: Numbers) -> tuple[Numbers, Numbers]:
    """Returns the examples mirrored left to right."""
    turned = actions.copy()
    turned[:, 0] = CHOICES[0] - 1 - turned[:, 0]
    return observations * MIRROR, turned


def held_out(count: int, seed: Sequence[int]) -> npt.NDArray[np.bool_]:
    """Returns which examples of a lesson are held out, ``(count,)``: 5% of them, in blocks.

    Args:
        count: number of examples.
        seed: seed of the choice; the same one gives the same examples in each round.
    """
    random = np.random.default_rng(seed)
    chosen = np.repeat(random.random(count // 100 + 1) < 0.05, 100)[:count]
    if chosen.all() or not chosen.any():
        chosen = np.arange(count) % 20 == 0
    return chosen


def fit(
    network: RacingNetwork,
    observations: Numbers,
    actions: Numbers,
    is_held_out: npt.NDArray[np.bool_],
    *,
    n_epochs: int,
    learning_rate: float,
    batch_size: int,
    seed: int,
) -> dict[str, Any]:
    """Trains a network on examples and evaluates it on those that are held out.

    Args:
        network: its policy learns, from its current weights on.
        observations: ``(N, inputs)``.
        actions: ``(N, 5)``.
        is_held_out: ``(N,)``, see :func:`held_out`. As the network keeps its weights from round to
            round, an example must be held out in all rounds or in none.
        n_epochs: passes over all examples.
        learning_rate: initial learning rate of Adam; it decays to 0.
        batch_size: examples per gradient step.
        seed: seed of their order.

    Returns:
        For the log: ``loss``, the mean cross-entropy, summed over the five choices [nats], and
            ``accuracy``, the fraction of correct choices: steering, pedal, drift, nitro, fire.
    """
    torch = training_torch()
    random = np.random.default_rng(seed)
    kept = observations[~is_held_out], actions[~is_held_out]
    both = [np.concatenate(pair) for pair in zip(kept, mirrored(*kept), strict=True)]
    inputs = torch.from_numpy(both[0].astype(np.float32))
    targets = torch.from_numpy(both[1].astype(np.int64))
    bells = torch.from_numpy(_bells())
    optimizer = torch.optim.Adam(network.policy.parameters(), lr=learning_rate)
    total = max(n_epochs * -(-len(targets) // batch_size), 1)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, total)
    for _ in range(n_epochs):
        order = torch.from_numpy(random.permutation(len(targets)))
        for rows in order.split(batch_size):
            steer, *others = targets[rows].T
            parts = network.policy(inputs[rows]).split(CHOICES, dim=1)
            loss = sum(_losses(parts, [bells[steer], *others]))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    return _judge(torch, network, observations[is_held_out], actions[is_held_out])


def _bells() -> npt.NDArray[np.float32]:
    """Returns the smoothed target for each steering choice, ``(21, 21)``."""
    places = np.arange(CHOICES[0])
    bells = np.exp(-(((places[:, None] - places) / _BLUR) ** 2) / 2)
    shares: npt.NDArray[np.float32] = (bells / bells.sum(axis=1, keepdims=True)).astype(np.float32)
    return shares


def _losses(logits: Sequence[Any], targets: Sequence[Any]) -> list[Any]:
    """Returns the mean cross-entropy of each choice; targets are indices or distributions."""
    entropy = training_library("torch").nn.functional.cross_entropy
    return [entropy(*pair) for pair in zip(logits, targets, strict=True)]


def _judge(
    torch: Any, network: RacingNetwork, observations: Numbers, actions: Numbers
) -> dict[str, Any]:
    targets = torch.from_numpy(actions.astype(np.int64)).T
    with torch.no_grad():
        logits = network.policy(torch.from_numpy(observations.astype(np.float32)))
        parts = logits.split(CHOICES, dim=1)
        loss = sum(map(float, _losses(parts, targets)))
        right = [
            float((part.argmax(1) == target).float().mean())
            for part, target in zip(parts, targets, strict=True)
        ]
    return {"loss": round(loss, 4), "accuracy": [round(share, 4) for share in right]}
