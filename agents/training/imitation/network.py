"""Learns choices from examples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.pretrained.action_filter import INPUT_MIRROR
from stkzoo.wrappers.racing import CHOICES

from ..common.command import training_library, training_torch
from ..ppo.network import RacingNetwork

Numbers = npt.NDArray[Any]

#: Standard deviation of the label smoothing over neighboring steering choices [choices].
_BLUR = 0.7


def mirrored(observations: Numbers, actions: Numbers) -> tuple[Numbers, Numbers]:
    """Returns the examples mirrored left to right."""
    turned = actions.copy()
    turned[:, 0] = CHOICES[0] - 1 - turned[:, 0]
    return observations * INPUT_MIRROR[: observations.shape[1]], turned


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
