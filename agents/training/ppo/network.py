"""Policy and value network of PPO over plans, in PyTorch for training and numpy for acting."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning.arrays import FloatArray
from stkzoo.agents.planning.driver import HEADS, INPUT_SIZE, mirrored_inputs
from stkzoo.agents.pretrained.policy import INPUT_CLIP, RacingPolicy
from stkzoo.agents.pretrained.weights import load_weights

from ..common.command import training_torch
from ..common.ppo import Weights, make_layers
from .rollouts import NUM_LOGITS, choice_columns

#: Minimum standard deviation of an input, so that constant inputs are not amplified.
_LEAST_SCALE = np.float32(0.2)


class ActorCritic:
    """Policy and value network with their optimizer.

    Args:
        hidden: units of the hidden layers.
        seed: seed of the initial weights.
        learns: names of the choices to train.
        init: file with initial weights; empty for new weights.
        penalty_coef: coefficient of the KL penalty towards the plans' prior.

    Attributes:
        policy: layers of the policy, a PyTorch module.
        value: layers of the value network.
        optimiser: optimizer of both; its first parameter group is the policy's.
        columns: columns of the trained choices.

    Raises:
        ConfigError: a name or the file is invalid, or PyTorch is not installed.
    """

    def __init__(
        self,
        hidden: Sequence[int],
        seed: int,
        learns: Sequence[str],
        init: str,
        penalty_coef: float = 0.0,
    ) -> None:
        self.torch = torch = training_torch()
        self.penalty_coef, self._is_given = penalty_coef, bool(init)
        torch.manual_seed(seed)
        size = INPUT_SIZE
        self.mean, self.scale = np.zeros(size, np.float32), np.ones(size, np.float32)
        self.policy = make_layers(torch, (size, *hidden, NUM_LOGITS), torch.nn.ReLU, 0.01)
        self.columns = choice_columns(learns)
        with torch.no_grad():
            for column in set(range(len(HEADS))) - set(self.columns):
                self.policy[-1].weight[HEADS[column]] = 0.0
        self.value = make_layers(torch, (size, *hidden, 1), torch.nn.ReLU, 1.0)
        if init:
            self._start_from(load_weights(init))
        self.optimiser = torch.optim.Adam(
            [{"params": self.policy.parameters()}, {"params": self.value.parameters()}], eps=1e-5
        )

    def _start_from(self, weights: dict[str, FloatArray]) -> None:
        self.mean, self.scale = weights["mean"], weights["scale"]
        with self.torch.no_grad():
            for number, layer in enumerate(self.policy[::2]):
                layer.weight.copy_(self.torch.from_numpy(weights[f"w{number}"].T.copy()))
                layer.bias.copy_(self.torch.from_numpy(weights[f"b{number}"]))

    def _arrays(self, layers: Any) -> dict[str, FloatArray]:
        arrays = {"mean": self.mean, "scale": self.scale}
        for number, layer in enumerate(layers[::2]):
            arrays[f"w{number}"] = layer.weight.detach().numpy().T.copy()
            arrays[f"b{number}"] = layer.bias.detach().numpy().copy()
        return arrays

    def actor(self) -> RacingPolicy:
        """Returns the current policy in numpy."""
        return RacingPolicy(self._arrays(self.policy))

    def weights(self) -> tuple[Weights, Weights]:
        """See :class:`..common.ppo.PPONetwork`."""
        return self.actor().weights, self._arrays(self.value)

    def fit_normalisation(self, inputs: FloatArray) -> None:
        """Sets mean and scale from inputs ``(N, F)``, equal for a race and its mirror image."""
        both = np.concatenate([inputs, mirrored_inputs(inputs)])
        self.mean = both.mean(axis=0)
        self.scale = 1.0 / np.maximum(both.std(axis=0), _LEAST_SCALE)

    def prepare(self, seen: npt.NDArray[np.void]) -> bool:
        """See :class:`..common.ppo.PPONetwork`: fits the normalization unless it is given."""
        if not self._is_given:
            self.fit_normalisation(seen["inputs"])
        return not self._is_given

    def tensors(self, seen: npt.NDArray[np.void]) -> list[Any]:
        """Returns inputs ``(N, F)``, normalized, prior and choices in rows of a rollout."""
        inputs = np.clip((seen["inputs"] - self.mean) * self.scale, -INPUT_CLIP, INPUT_CLIP)
        arrays = inputs, seen["prior"].copy(), seen["choices"].copy()
        return [self.torch.from_numpy(array) for array in arrays]

    def evaluate(self, columns: Sequence[Any]) -> tuple[Any, Any, Any, Any]:
        """See :class:`..common.ppo.PPONetwork`; the penalty is the KL from the prior [nats]."""
        inputs, prior, choices = columns
        logits = prior + self.policy(inputs)
        log_softmax = self.torch.log_softmax
        log_probability, entropy, prior_kl = 0.0, 0.0, 0.0
        for column in self.columns:
            head = HEADS[column]
            logs = log_softmax(logits[:, head], dim=1)
            prior_logs = log_softmax(prior[:, head], dim=1)
            chosen = logs.gather(1, choices[:, column : column + 1])[:, 0]
            log_probability = log_probability + chosen
            entropy = entropy - (logs.exp() * logs).sum(1)
            prior_kl = prior_kl + (logs.exp() * (logs - prior_logs)).sum(1)
        return log_probability, entropy, prior_kl, self.value(inputs)[:, 0]

    def state(self) -> dict[str, Any]:
        """Returns weights, optimizer and normalization as tensors, for :meth:`restore`."""
        return {
            "policy": self.policy.state_dict(),
            "value": self.value.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "mean": self.torch.from_numpy(self.mean),
            "scale": self.torch.from_numpy(self.scale),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restores a :meth:`state`."""
        self.policy.load_state_dict(state["policy"])
        self.value.load_state_dict(state["value"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.mean, self.scale = state["mean"].numpy(), state["scale"].numpy()
