"""A small network that maps a kart's observation and memory to choices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from stkzoo.agents.planning import FloatArray, IntArray
from stkzoo.agents.planning.driver import (
    CHOICES,
    INPUT_SIZE,
    INPUT_SIZE_WITHOUT_HOLD,
    PolicyInput,
    likeliest,
)
from stkzoo.agents.planning.network import Mlp
from stkzoo.errors import ConfigError

#: Largest absolute value of a normalized input.
INPUT_CLIP = 8.0


class Network:
    """Two hidden layers of rectified linear units on normalized inputs, and a linear output.

    Args:
        weights: ``mean`` and ``scale`` ``(F,)`` of the input, and ``w0``, ``b0``, ``w1``, ``b1``,
            ``w2``, ``b2``: matrices ``(inputs, outputs)`` and biases of the layers. A network with
            fewer inputs takes the first ones.
    """

    def __init__(self, weights: Mapping[str, FloatArray]) -> None:
        self._mean, self._scale = weights["mean"], weights["scale"]
        self._mlp = Mlp([(weights[f"w{n}"], weights[f"b{n}"]) for n in range(3)], False)

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Returns outputs ``(A, outputs)`` for inputs ``(A, F)``, row by row."""
        seen = inputs[:, : len(self._mean)]
        return self._mlp(np.clip((seen - self._mean) * self._scale, -INPUT_CLIP, INPUT_CLIP))


def network_shapes(hidden: Sequence[int], *, holds: bool = True) -> dict[str, tuple[int, ...]]:
    """Returns the shapes of the weights of a policy's :class:`Network`.

    Args:
        hidden: units of the hidden layers.
        holds: whether the policy observes which steering offset it holds.
    """
    inputs = INPUT_SIZE if holds else INPUT_SIZE_WITHOUT_HOLD
    sizes = (inputs, *hidden, sum(CHOICES))
    shapes: dict[str, tuple[int, ...]] = {"mean": (inputs,), "scale": (inputs,)}
    for layer in range(3):
        shapes |= {f"w{layer}": sizes[layer : layer + 2], f"b{layer}": (sizes[layer + 1],)}
    return shapes


def check_shapes(weights: Mapping[str, FloatArray], name: str) -> None:
    """Checks that arrays are the weights of a policy over plans.

    Args:
        weights: arrays by name.
        name: name of the weights in error messages.

    Raises:
        ConfigError: a name or a shape is wrong.
    """
    hidden = [weights[key].size if key in weights else 0 for key in ("b0", "b1")]
    shapes = {key: array.shape for key, array in weights.items()}
    wanted = network_shapes(hidden)
    if shapes not in (wanted, network_shapes(hidden, holds=False)) or not all(
        np.isfinite(array).all() for array in weights.values()
    ):
        raise ConfigError(
            f"the weights {name!r} have the shapes {shapes}, expected finite numbers of "
            f"{wanted}; they are from another version of stkzoo or another program"
        )


def log_sum(logits: FloatArray) -> FloatArray:
    """Returns the log-sum-exp along the last axis, which is kept with size 1."""
    top = logits.max(axis=-1, keepdims=True)
    total: FloatArray = np.log(np.exp(logits - top).sum(axis=-1, keepdims=True)) + top
    return total


class RacingPolicy:
    """A policy over plans: its logits are the sum of the prior's and the learned ones.

    Args:
        weights: weights of the :class:`Network`.

    Attributes:
        weights: the same.
    """

    def __init__(self, weights: Mapping[str, FloatArray]) -> None:
        self.weights = weights
        self._network = Network(weights)

    @classmethod
    def of_plans_alone(cls) -> RacingPolicy:
        """Returns a policy that adds nothing to the prior."""
        shapes = network_shapes((1, 1)).items()
        return cls({name: np.zeros(shape, np.float32) for name, shape in shapes})

    def logits(self, view: PolicyInput) -> FloatArray:
        """Returns the logits, ``(A, sum(CHOICES))``; each row depends only on its own input."""
        logits: FloatArray = view.prior + self.learned_logits(view)
        return logits

    def learned_logits(self, view: PolicyInput) -> FloatArray:
        """Returns the learned logits without the prior, ``(A, sum(CHOICES))``."""
        return self._network(view.inputs)

    def best(self, view: PolicyInput) -> IntArray:
        """Returns the most likely choices, ``(A, 4)``; each row depends only on its own input."""
        return likeliest(self.logits(view))
