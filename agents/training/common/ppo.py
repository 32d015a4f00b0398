"""Proximal policy optimization (PPO) whose actors keep driving while it learns.

The method is that of Schulman et al. (2017), with generalized advantage estimation (GAE). Rollouts
are from the networks before the latest update; PPO's probability ratio corrects for that.
"""

from __future__ import annotations

import itertools
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.pretrained.policy import INPUT_CLIP

from .arguments import OverlappedArguments
from .command import training_torch
from .learner import FloatArray, LearningNetwork, OverlappedLearner, RolloutResult

#: Value that corresponds to an output of 1 of the value network.
VALUE_UNIT = 10.0
#: Fields of a rollout that every method needs.
FIELDS: list[tuple[Any, ...]] = [
    ("log_probability", np.float32),
    ("values", np.float32),
    ("rewards", np.float32),
    ("next_values", np.float32),  # value after the last step of an ended race
    ("active", np.bool_),
    ("driven", np.bool_),
    ("ended", np.bool_),
]
#: Ratio of the learning rates of value and policy.
_VALUE_RATE = 4.0
#: Largest norm of the gradient of policy or value network.
_MAX_GRADIENT = 0.5
#: Parts of a network with a PyTorch state.
_PARTS = ("policy", "value", "optimizer")


class PPONetwork(LearningNetwork):
    """A policy and a value network in PyTorch, with their optimizer.

    Args:
        seed: seed of the initial weights.
        policy_sizes: number of inputs, units of each hidden layer, number of logits.
        value_sizes: number of inputs, units of each hidden layer, and 1.
        policy_activation: name in ``torch.nn`` of the module between two layers of the policy; the
            value network has ``"ReLU"``.

    Attributes:
        torch: the module ``torch``.
        policy: layers of the policy.
        value: layers of the value network.
        optimizer: optimizer of both; its first parameter group is the policy's.
        penalty_coef: weight of the penalty in the loss.
        mean: mean of the value network's inputs, by which they are normalized.
        scale: factor by which they are normalized.

    Raises:
        ConfigError: PyTorch is not installed.
    """

    penalty_coef = 0.0

    def __init__(
        self,
        seed: int,
        policy_sizes: Sequence[int],
        value_sizes: Sequence[int],
        policy_activation: str,
    ) -> None:
        self.torch = torch = training_torch()
        torch.manual_seed(seed)
        activation = getattr(torch.nn, policy_activation)
        self.policy = _make_layers(torch, policy_sizes, activation, 0.01)
        self.value = _make_layers(torch, value_sizes, torch.nn.ReLU, 1.0)
        size = value_sizes[0]
        self.mean, self.scale = np.zeros(size, np.float32), np.ones(size, np.float32)
        self.optimizer = torch.optim.Adam(
            [{"params": self.policy.parameters()}, {"params": self.value.parameters()}], eps=1e-5
        )

    @abstractmethod
    def tensors(self, seen: npt.NDArray[np.void]) -> list[Any]:
        """Returns the inputs of :meth:`evaluate` for rows of a rollout, as tensors ``(N, ...)``."""

    @abstractmethod
    def evaluate(self, columns: Sequence[Any]) -> tuple[Any, Any, Any, Any]:
        """Evaluates the choices in rows of a rollout.

        Returns:
            Tensors ``(N,)``: log-probability of the choices, entropy of the policy, a penalty, and
                the value in units of :data:`VALUE_UNIT`.
        """

    def descend(self, loss: Any) -> None:
        """Makes a gradient step on a loss."""
        self.optimizer.zero_grad()
        loss.backward()
        for layers in (self.policy, self.value):
            self.torch.nn.utils.clip_grad_norm_(layers.parameters(), _MAX_GRADIENT)
        self.optimizer.step()

    def normalized(self, inputs: FloatArray) -> FloatArray:
        """Returns inputs ``(N, F)`` of the value network, normalized and clipped."""
        found: FloatArray = np.clip((inputs - self.mean) * self.scale, -INPUT_CLIP, INPUT_CLIP)
        return found

    def arrays(self, layers: Any) -> dict[str, FloatArray]:
        """Returns layers in the form of :class:`~stkzoo.agents.pretrained.policy.Network`."""
        arrays = {"mean": self.mean, "scale": self.scale}
        for number, layer in enumerate(layers[::2]):
            arrays[f"w{number}"] = layer.weight.detach().numpy().T.copy()
            arrays[f"b{number}"] = layer.bias.detach().numpy().copy()
        return arrays

    def state(self) -> dict[str, Any]:
        """See :class:`.learner.LearningNetwork`."""
        parts = {name: getattr(self, name).state_dict() for name in _PARTS}
        scales = {"mean": self.mean, "scale": self.scale}
        return parts | {name: self.torch.from_numpy(array) for name, array in scales.items()}

    def restore(self, state: dict[str, Any]) -> None:
        """See :class:`.learner.LearningNetwork`."""
        for name in _PARTS:
            getattr(self, name).load_state_dict(state[name])
        self.mean, self.scale = state["mean"].numpy(), state["scale"].numpy()


def _make_layers(torch: Any, sizes: Sequence[int], activation: Any, last_gain: float) -> Any:
    """Returns linear layers with orthogonal weights and no biases, as one PyTorch module.

    Args:
        torch: the module ``torch``.
        sizes: number of inputs, units of each hidden layer, number of outputs.
        activation: makes the module between two layers.
        last_gain: gain of the last layer's weights; that of the others is the root of 2.
    """
    nn = torch.nn
    parts: list[Any] = []
    for number, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
        is_last = number == len(sizes) - 2
        layer = nn.Linear(inputs, outputs)
        nn.init.orthogonal_(layer.weight, last_gain if is_last else 2**0.5)
        nn.init.zeros_(layer.bias)
        parts += [layer] if is_last else [layer, activation()]
    return nn.Sequential(*parts)


def advantages_of(
    rollout: npt.NDArray[np.void], last_values: FloatArray, gamma: float, gae_lambda: float
) -> FloatArray:
    """Returns generalized advantages ``(T, S)``; ended races are bootstrapped."""
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


class OverlappedPPO(OverlappedLearner):
    """A run of PPO; see :class:`.learner.OverlappedLearner`."""

    _network: PPONetwork
    arguments: OverlappedArguments

    def _update(
        self, rollouts: Sequence[npt.NDArray[np.void]], driven: Sequence[RolloutResult]
    ) -> dict[str, float]:
        """Runs several epochs of gradient steps on the rollouts."""
        settings, nets = self.arguments, self._network
        gained = [
            advantages_of(rollout, own.last_values, settings.gamma, settings.gae_lambda)
            for rollout, own in zip(rollouts, driven, strict=True)
        ]
        rows = [rollout["active"] & rollout["driven"] for rollout in rollouts]
        pairs = zip(rollouts, rows, strict=True)
        seen = np.concatenate([rollout[chosen] for rollout, chosen in pairs])
        advantages = np.concatenate([own[r] for own, r in zip(gained, rows, strict=True)])
        returns = advantages + seen["values"]
        rate, ent_coef = self._anneal()
        from_numpy = nets.torch.from_numpy
        data = [
            from_numpy(seen["log_probability"].copy()),
            from_numpy((advantages - advantages.mean()) / (advantages.std() + 1e-6)),
            from_numpy(returns / VALUE_UNIT),
            *nets.tensors(seen),
        ]
        figures: dict[str, list[float]] = {}
        epochs = 0
        for _ in range(settings.n_epochs):
            epochs += 1
            kl = []
            for batch in self._batches(len(seen)):
                found = self._gradient_step([column[batch] for column in data], ent_coef)
                kl.append(found["kl"])
                for name, value in found.items():
                    figures.setdefault(name, []).append(value)
            if np.mean(kl) > settings.target_kl:
                break
        unexplained = np.var(advantages) / max(float(np.var(returns)), 1e-9)
        return {
            **{name: float(np.mean(values)) for name, values in figures.items()},
            "epochs": epochs,
            "learning_rate": rate,
            "explained": float(1.0 - unexplained),
            "reward": float(sum(rollout["rewards"].sum() for rollout in rollouts) / len(seen)),
        }

    def _anneal(self) -> tuple[float, float]:
        """Sets the learning rates; returns the policy's and the entropy coefficient."""
        settings, groups = self.arguments, self._network.optimizer.param_groups
        left = max(1.0 - self.kart_steps / settings.anneal_timesteps, 0.0)
        rate = settings.learning_rate * max(left, 0.05)
        is_warming = self.iteration < settings.warm_up
        groups[0]["lr"] = 0.0 if is_warming else rate
        groups[1]["lr"] = _VALUE_RATE * rate
        return rate, settings.ent_coef * max(left, 0.1)

    def _batches(self, count: int) -> list[Any]:
        order = self._network.torch.from_numpy(self._random.permutation(count))
        return [rows for rows in order.split(self.arguments.batch_size) if len(rows) > 1]

    def _gradient_step(self, batch: Sequence[Any], ent_coef: float) -> dict[str, float]:
        old, advantages, returns, *columns = batch
        torch, nets, clip = self._network.torch, self._network, self.arguments.clip_range
        log_probability, entropy, penalty, values = nets.evaluate(columns)
        log_ratio = log_probability - old
        ratio = log_ratio.exp()
        clipped = ratio.clamp(1 - clip, 1 + clip)
        objective = torch.minimum(ratio * advantages, clipped * advantages).mean()
        value_loss = (values - returns).square().mean()
        penalty = penalty.mean()
        loss = value_loss - objective - ent_coef * entropy.mean() + nets.penalty_coef * penalty
        nets.descend(loss)
        with torch.no_grad():
            return {
                "kl": float((ratio - 1 - log_ratio).mean()),
                "clip_fraction": float(((ratio - 1).abs() > clip).float().mean()),
                "entropy": float(entropy.mean()),
                "penalty": float(penalty),
                "value_loss": float(value_loss),
            }
