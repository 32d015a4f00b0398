"""Policy and value network of PPO over plans, in PyTorch for training and numpy for acting."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning import FloatArray
from stkzoo.agents.planning.driver import HEADS, INPUT_SIZE, mirrored_inputs
from stkzoo.agents.pretrained.policy import check_shapes
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.errors import ConfigError

from ..common.learner import Weights
from ..common.ppo import PPONetwork
from .rollouts import NUM_LOGITS, choice_columns

#: Minimum standard deviation of an input, so that constant inputs are not amplified.
_LEAST_SCALE = np.float32(0.2)


class ActorCritic(PPONetwork):
    """Policy and value network over plans; see :class:`..common.ppo.PPONetwork`.

    Args:
        hidden: units of the hidden layers.
        seed: seed of the initial weights.
        learns: names of the choices to train.
        penalty_coef: coefficient of the KL penalty toward the plans' prior.

    Attributes:
        columns: columns of the trained choices.

    Raises:
        ConfigError: a name is invalid, or PyTorch is not installed.
    """

    def __init__(
        self,
        hidden: Sequence[int],
        seed: int,
        learns: Sequence[str],
        penalty_coef: float = 0.0,
    ) -> None:
        self.columns = choice_columns(learns)
        sizes = INPUT_SIZE, *hidden
        super().__init__(seed, (*sizes, NUM_LOGITS), (*sizes, 1), "ReLU")
        self.penalty_coef, self._is_given = penalty_coef, False
        with self.torch.no_grad():
            for column in set(range(len(HEADS))) - set(self.columns):
                self.policy[-1].weight[HEADS[column]] = 0.0

    def start_from(self, weights: dict[str, FloatArray]) -> None:
        """Copies the policy and its normalization from :func:`initial_weights`."""
        self._is_given = True
        self.mean, self.scale = weights["mean"], weights["scale"]
        with self.torch.no_grad():
            for number, layer in enumerate(self.policy[::2]):
                layer.weight.copy_(self.torch.from_numpy(weights[f"w{number}"].T.copy()))
                layer.bias.copy_(self.torch.from_numpy(weights[f"b{number}"]))

    def weights(self) -> tuple[Weights, Weights]:
        """See :class:`..common.learner.LearningNetwork`."""
        return self.arrays(self.policy), self.arrays(self.value)

    def fit_normalization(self, inputs: FloatArray) -> None:
        """Sets mean and scale from inputs ``(N, F)``, equal for a race and its mirror image."""
        both = np.concatenate([inputs, mirrored_inputs(inputs)])
        self.mean = both.mean(axis=0)
        self.scale = 1.0 / np.maximum(both.std(axis=0), _LEAST_SCALE)

    def prepare(self, seen: npt.NDArray[np.void]) -> bool:
        """Fits the normalization unless it is given.

        See :class:`..common.learner.LearningNetwork`.
        """
        if not self._is_given:
            self.fit_normalization(seen["inputs"])
        return not self._is_given

    def tensors(self, seen: npt.NDArray[np.void]) -> list[Any]:
        """Returns inputs ``(N, F)``, normalized, prior and choices in rows of a rollout."""
        inputs = self.normalized(seen["inputs"])
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


def initial_weights(init: str, hidden: Sequence[int]) -> dict[str, FloatArray]:
    """Returns the weights of a policy over plans from a file.

    If the policy does not observe the offset that it holds, this input initially has no effect.

    Args:
        init: the file.
        hidden: units of the hidden layers.

    Raises:
        ConfigError: the file is unreadable, contains something else, or has other layers.
    """
    weights = load_weights(init)
    check_shapes(weights, init)
    found = len(weights["b0"]), len(weights["b1"])
    if found != tuple(hidden):
        raise ConfigError(
            f"the weights {init!r} have layers of {found[0]} and {found[1]} units, "
            f"expected {tuple(hidden)}; give --hidden {found[0]} {found[1]}"
        )
    more = INPUT_SIZE - len(weights["mean"])
    return weights | {
        "mean": np.pad(weights["mean"], (0, more)),
        "scale": np.pad(weights["scale"], (0, more), constant_values=1.0),
        "w0": np.pad(weights["w0"], ((0, more), (0, 0))),
    }
