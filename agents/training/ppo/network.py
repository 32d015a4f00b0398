"""Policy and value network of PPO over plans, in torch for learning and in numpy for acting."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stkzoo.agents.planning.arrays import FloatArray
from stkzoo.agents.planning.driver import CHOICE_NAMES, CHOICES, HEADS, INPUT_SIZE, mirrored_inputs
from stkzoo.agents.pretrained.policy import INPUT_CLIP, RacingPolicy, network
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.errors import ConfigError

from ..common.command import training_torch

NUM_LOGITS = sum(CHOICES)
#: Lower limit of an input's standard deviation, so that constant inputs are not amplified.
_LEAST_SCALE = np.float32(0.2)
#: The value that an output of 1 stands for.
VALUE_UNIT = 10.0


class ActorCritic:
    """Policy and value network with their optimiser.

    Args:
        hidden: units of the hidden layers.
        seed: seed of the initial weights.
        learns: names of the choices that are learned.
        init: file of weights to start from; empty starts from nothing.

    Attributes:
        policy: the policy's layers, a torch module.
        value: the value's layers.
        optimiser: of both; its first parameter group is the policy's.
        columns: columns of the choices that are learned.

    Raises:
        ConfigError: a name or the file is wrong, or torch is not installed.
    """

    def __init__(self, hidden: Sequence[int], seed: int, learns: Sequence[str], init: str) -> None:
        self.torch = torch = training_torch()
        torch.manual_seed(seed)
        size = INPUT_SIZE
        self.mean, self.scale = np.zeros(size, np.float32), np.ones(size, np.float32)
        self.policy = self._layers((size, *hidden, NUM_LOGITS), 0.01)
        self.columns = _columns(learns)
        with torch.no_grad():
            for column in set(range(len(HEADS))) - set(self.columns):
                self.policy[-1].weight[HEADS[column]] = 0.0
        self.value = self._layers((size, *hidden, 1), 1.0)
        if init:
            self._start_from(load_weights(init))
        self.optimiser = torch.optim.Adam(
            [{"params": self.policy.parameters()}, {"params": self.value.parameters()}], eps=1e-5
        )

    def _layers(self, sizes: Sequence[int], last_gain: float) -> Any:
        nn = self.torch.nn
        parts: list[Any] = []
        for number, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
            is_last = number == len(sizes) - 2
            layer = nn.Linear(inputs, outputs)
            nn.init.orthogonal_(layer.weight, last_gain if is_last else 2**0.5)
            nn.init.zeros_(layer.bias)
            parts += [layer] if is_last else [layer, nn.ReLU()]
        return nn.Sequential(*parts)

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
        """The present policy in numpy."""
        return RacingPolicy(self._arrays(self.policy))

    def critic(self) -> dict[str, FloatArray]:
        """The present weights of the value in numpy, for :func:`predict_values`."""
        return self._arrays(self.value)

    def fit_normalisation(self, inputs: FloatArray) -> None:
        """Takes mean and scale from inputs, the same for a race and its mirror image."""
        both = np.concatenate([inputs, mirrored_inputs(inputs)])
        self.mean = both.mean(axis=0)
        self.scale = 1.0 / np.maximum(both.std(axis=0), _LEAST_SCALE)

    def normalised(self, inputs: FloatArray) -> Any:
        """The layers' inputs, a tensor."""
        return self.torch.from_numpy(
            np.clip((inputs - self.mean) * self.scale, -INPUT_CLIP, INPUT_CLIP)
        )

    def evaluate(self, inputs: Any, prior: Any, choices: Any) -> tuple[Any, Any, Any, Any]:
        """Evaluates choices; tensors ``(B,)`` each.

        Args:
            inputs: normalised, ``(B, F)``.
            prior: logits of the plans alone, ``(B, NUM_LOGITS)``.
            choices: ``(B, 4)``.

        Returns:
            The choices' log-probability, the policy's entropy, its divergence from the prior
            [nats], and the value of the inputs in units of :data:`VALUE_UNIT`.
        """
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
        """Weights, optimiser and normalisation as tensors, for :meth:`restore`."""
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


def predict_values(critic: Mapping[str, FloatArray], inputs: FloatArray) -> FloatArray:
    """The values of inputs ``(B, F)`` by the weights of :meth:`ActorCritic.critic`."""
    values: FloatArray = network(critic, inputs)[:, 0] * np.float32(VALUE_UNIT)
    return values


def _columns(names: Sequence[str]) -> list[int]:
    """The columns of choices by name."""
    unknown = sorted(set(names) - set(CHOICE_NAMES))
    if unknown or not names:
        raise ConfigError(f"learns is {list(names)}; expected some of {', '.join(CHOICE_NAMES)}")
    return sorted(CHOICE_NAMES.index(name) for name in set(names))
