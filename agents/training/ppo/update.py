"""The update of proximal policy optimization (PPO; Schulman et al., 2017)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning import FloatArray

from ..common.arguments import RolloutArguments
from .network import ActorCritic

#: Ratio of the learning rates of value and policy.
_VALUE_RATE = 4.0


def advantages_of(
    rollout: npt.NDArray[np.void], last_values: FloatArray, gamma: float, gae_lambda: float
) -> FloatArray:
    """Returns generalized advantages (GAE) ``(T, S)``; ended races are bootstrapped.

    Args:
        rollout: ``(T, S)`` of :meth:`.rollouts.PolicyShape.rollout_type`.
        last_values: ``(S,)`` values after the last step.
        gamma: discount factor per step.
        gae_lambda: lambda of GAE.
    """
    advantages = np.zeros(rollout.shape, np.float32)
    advantage, next_values = np.zeros_like(last_values), last_values
    rewards, values, ends = rollout["rewards"], rollout["values"], rollout["ended"]
    for step in reversed(range(len(rollout))):
        ended = ends[step]
        next_values = np.where(ended, rollout["next_values"][step], next_values)
        delta = rewards[step] + gamma * next_values - values[step]
        advantage = delta + gamma * gae_lambda * np.where(ended, 0, advantage)
        advantage = np.where(rollout["active"][step], advantage, 0).astype(np.float32)
        advantages[step], next_values = advantage, values[step]
    return advantages


def anneal(
    network: ActorCritic, settings: RolloutArguments, kart_steps: int, iteration: int
) -> float:
    """Sets the learning rates of the networks; returns the entropy coefficient."""
    left = max(1.0 - kart_steps / settings.anneal_timesteps, 0.0)
    rate = settings.learning_rate * max(left, 0.05)
    policy, value = network.optimizer.param_groups
    policy["lr"] = 0.0 if iteration < settings.warm_up else rate
    value["lr"] = _VALUE_RATE * rate
    return settings.ent_coef * max(left, 0.1)


def update(
    network: ActorCritic,
    rollouts: Sequence[npt.NDArray[np.void]],
    last_values: Sequence[FloatArray],
    settings: RolloutArguments,
    ent_coef: float,
    random: np.random.Generator,
) -> dict[str, float]:
    """Runs several epochs of gradient steps on rollouts.

    The rollouts are from the networks before the latest update; PPO's probability ratio corrects
    for that.

    Args:
        network: the networks; changed.
        rollouts: a rollout ``(T, S)`` of each actor.
        last_values: the values ``(S,)`` after it.
        settings: hyperparameters.
        ent_coef: entropy coefficient.
        random: draws the batches.

    Returns:
        Figures for the log.
    """
    gained = [
        advantages_of(rollout, after, settings.gamma, settings.gae_lambda)
        for rollout, after in zip(rollouts, last_values, strict=True)
    ]
    length = network.sequence
    seen, advantages = (
        np.concatenate([_sequences(part, length) for part in parts]) for parts in (rollouts, gained)
    )
    used = seen["active"] & seen["driven"]
    learns = used.any(axis=1)
    seen, advantages, used = (part[learns].reshape(-1) for part in (seen, advantages, used))
    returns = advantages + seen["values"]
    network.normalize_returns(returns[used])
    mean, unit = network.returns
    from_numpy, learned = network.torch.from_numpy, advantages[used]
    inputs, *columns = network.tensors(seen)
    data = [
        from_numpy(seen["log_probability"].copy()),
        from_numpy((advantages - learned.mean()) / (learned.std() + 1e-6)),
        from_numpy((returns - mean) / unit),
        *columns,
    ]
    is_learned = from_numpy(used)
    batch_size = max(settings.batch_size // length, 1) * length
    figures: dict[str, list[float]] = {}
    epochs = 0
    for _ in range(settings.n_epochs):
        epochs += 1
        kl = []
        # All rows, in sequences whose order is random.
        order = random.permutation(len(seen) // length)[:, None] * length + np.arange(length)
        for rows in from_numpy(order.reshape(-1)).split(batch_size):
            if len(rows) > 1:
                is_used = is_learned[rows]
                chosen = network.chosen_inputs(inputs, rows, is_used)
                batch = [chosen, *(column[rows[is_used]] for column in data)]
                step_figures = _gradient_step(network, batch, settings, ent_coef)
                kl.append(step_figures["kl"])
                for name, value in step_figures.items():
                    figures.setdefault(name, []).append(value)
        if np.mean(kl) > settings.target_kl:
            break
    unexplained = np.var(learned) / max(float(np.var(returns[used])), 1e-9)
    return {
        **{name: float(np.mean(values)) for name, values in figures.items()},
        "epochs": epochs,
        "learning_rate": network.optimizer.param_groups[1]["lr"] / _VALUE_RATE,
        "explained": float(1.0 - unexplained),
        "reward": float(sum(rollout["rewards"].sum() for rollout in rollouts) / len(learned)),
    }


def _sequences(rows: npt.NDArray[Any], length: int) -> npt.NDArray[Any]:
    """Returns the rows ``(T, S)`` of slots as sequences of successive steps, ``(N, length)``."""
    by_slot = rows.reshape(-1, length, rows.shape[1]).swapaxes(1, 2)
    sequences: npt.NDArray[Any] = by_slot.reshape(-1, length)
    return sequences


def _gradient_step(
    network: ActorCritic, batch: Sequence[Any], settings: RolloutArguments, ent_coef: float
) -> dict[str, float]:
    """Makes a gradient step on PPO's clipped loss; returns figures."""
    inputs, old, advantages, returns, *columns = batch
    torch, clip = network.torch, settings.clip_range
    log_probability, entropy, prior_kl, values = network.evaluate([inputs, *columns])
    log_ratio = log_probability - old
    ratio = log_ratio.exp()
    clipped = ratio.clamp(1 - clip, 1 + clip)
    objective = torch.minimum(ratio * advantages, clipped * advantages).mean()
    value_loss = (values - returns).square().mean()
    entropy, penalty = entropy.mean(), prior_kl.mean()
    network.descend(value_loss - objective - ent_coef * entropy + network.kl_coef * penalty)
    with torch.no_grad():
        return {
            "kl": float((ratio - 1 - log_ratio).mean()),
            "clip_fraction": float(((ratio - 1).abs() > clip).float().mean()),
            "entropy": float(entropy),
            "penalty": float(penalty),
            "value_loss": float(value_loss),
        }
