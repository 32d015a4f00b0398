"""A small network in numpy that maps a kart's observation and memory to choices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stkzoo.agents.planning.arrays import FloatArray, IntArray
from stkzoo.agents.planning.driver import CHOICES, HEADS, INPUT_SIZE, PolicyInput, likeliest

#: Largest absolute value of a normalized input.
INPUT_CLIP = 8.0


def network(weights: Mapping[str, FloatArray], inputs: FloatArray) -> FloatArray:
    """Evaluates a network with two hidden layers of rectified linear units and a linear output.

    Args:
        weights: ``mean`` and ``scale`` ``(F,)`` of the input, and ``w0``, ``b0``, ``w1``, ``b1``,
            ``w2``, ``b2``: matrices ``(inputs, outputs)`` and biases of the layers.
        inputs: ``(..., F)``.
    """
    x = np.clip((inputs - weights["mean"]) * weights["scale"], -INPUT_CLIP, INPUT_CLIP)
    x = np.maximum(x @ weights["w0"] + weights["b0"], 0)
    x = np.maximum(x @ weights["w1"] + weights["b1"], 0)
    outputs: FloatArray = x @ weights["w2"] + weights["b2"]
    return outputs


def network_shapes(hidden: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """Returns the shapes of the weights of a policy's :func:`network` with these hidden layers."""
    sizes = (INPUT_SIZE, *hidden, sum(CHOICES))
    shapes: dict[str, tuple[int, ...]] = {"mean": (INPUT_SIZE,), "scale": (INPUT_SIZE,)}
    for layer in range(3):
        shapes |= {f"w{layer}": sizes[layer : layer + 2], f"b{layer}": (sizes[layer + 1],)}
    return shapes


def log_sum(logits: FloatArray) -> FloatArray:
    """Returns the log-sum-exp along the last axis, which is kept with size 1."""
    top = logits.max(axis=-1, keepdims=True)
    total: FloatArray = np.log(np.exp(logits - top).sum(axis=-1, keepdims=True)) + top
    return total


@dataclass(frozen=True, slots=True)
class RacingPolicy:
    """A policy over plans: its logits are the sum of the prior's and the learned ones.

    Attributes:
        weights: weights of the :func:`network`.
    """

    weights: Mapping[str, FloatArray]

    @classmethod
    def of_plans_alone(cls) -> RacingPolicy:
        """Returns a policy that adds nothing to the prior."""
        shapes = network_shapes((1, 1)).items()
        return cls({name: np.zeros(shape, np.float32) for name, shape in shapes})

    def logits(self, view: PolicyInput) -> FloatArray:
        """Returns the logits, ``(A, sum(CHOICES))``."""
        learned: FloatArray = view.prior + network(self.weights, view.inputs)
        return learned

    def best(self, view: PolicyInput) -> IntArray:
        """Returns the most likely choices, ``(A, 4)``; a kart's do not depend on other karts."""
        return likeliest(view.prior + network(self.weights, view.inputs[:, None])[:, 0])

    def sample(
        self,
        view: PolicyInput,
        random: np.random.Generator,
        columns: Sequence[int] = range(len(HEADS)),
    ) -> tuple[IntArray, FloatArray]:
        """Samples choices ``(A, 4)``; returns them and their log-probabilities ``(A,)``.

        Only ``columns`` are sampled; other choices are the most likely ones and count as certain.
        """
        logits = self.logits(view)
        noise = random.gumbel(size=logits.shape).astype(np.float32)
        rows = np.arange(len(logits))
        drawn = np.empty((len(logits), len(HEADS)), np.intp)
        log_probability = np.zeros(len(logits), np.float32)
        for column, head in enumerate(HEADS):
            own = logits[:, head]
            if column not in columns:
                drawn[:, column] = own.argmax(axis=1)
                continue
            choice = (own + noise[:, head]).argmax(axis=1)
            drawn[:, column] = choice
            log_probability += own[rows, choice] - log_sum(own)[:, 0]
        return drawn, log_probability
