"""A Stable-Baselines3 ``MlpPolicy`` on the view ``racing``, in numpy.

A file of it is a safetensors file of its state dict, and of how long it holds a drift.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NoReturn

import numpy as np

from stkzoo.agents.planning.arrays import FloatArray, IntArray
from stkzoo.errors import ConfigError
from stkzoo.wrappers.racing import CHOICES, SIZE

from .action_filter import INPUT_SIZE
from .weights import load_weights

_LAYER = "mlp_extractor.policy_net.{}.{}"
_LAST = "action_net.{}"
#: Where the logits of one choice end and those of the next begin.
SPLITS = np.cumsum(CHOICES)[:-1].tolist()
#: Under this name a file says for how many steps a drift is held.
HOLD = "drift_hold"
_MAX_HOLD = 1000


class MlpDriver:
    """The policy's part of a state dict, for any number of karts at once.

    Args:
        weights: a state dict, its arrays in numpy; what is not the policy's is left alone.
        name: what errors call it.

    Attributes:
        hold: for how many steps it holds a drift.
        inputs: how many numbers it sees: the view, and mostly what the the action filter remembers.

    Raises:
        ConfigError: they are not of an ``MlpPolicy`` on the view ``racing``.
    """

    def __init__(self, weights: Mapping[str, FloatArray], name: str = "the weights") -> None:
        held = float(np.asarray(weights.get(HOLD, np.zeros(1))).sum())
        if not 0 <= held <= _MAX_HOLD:
            raise ConfigError(f"{name} have {HOLD} {held}, expected 0 to {_MAX_HOLD} steps")
        self.hold = int(held)
        self._layers: list[tuple[FloatArray, FloatArray]] = []
        number = 0
        while _LAYER.format(number, "weight") in weights:
            self._layers.append(_layer(weights, _LAYER, number))
            number += 2  # every other one is the tanh
        if _LAST.format("weight") in weights:
            self._layers.append(_layer(weights, "action_net.{1}", 0))
        found = [matrix.shape for matrix, _ in self._layers]
        self.inputs = SIZE if found and found[0][-1] == SIZE else INPUT_SIZE
        sizes = [self.inputs, *(len(bias) for _, bias in self._layers)]
        wanted = list(zip(sizes[1:], sizes, strict=False))
        arrays = [array for layer in self._layers for array in layer]
        if (
            len(found) < 2
            or found != wanted
            or sizes[-1] != sum(CHOICES)
            or not all(np.isfinite(array).all() for array in arrays)
        ):
            raise ConfigError(
                f"{name} have layers of the shapes {found}, expected finite ones of a "
                f"Stable-Baselines3 MlpPolicy from the {SIZE} numbers of the view 'racing', or "
                f"{INPUT_SIZE} with what the action filter remembers, to its "
                f"{sum(CHOICES)} choices (mlp_extractor.policy_net.*, action_net.*)"
            )

    def logits(self, observations: FloatArray) -> FloatArray:
        """Those of all choices, ``(..., 31)``, of what karts see, ``(..., 177)``.

        A kart's depend in their last bits on how many rows there are.
        """
        x = np.asarray(observations[..., : self.inputs], np.float32)
        *hidden, (matrix, bias) = self._layers
        for weights, offset in hidden:
            x = np.tanh(x @ weights.T + offset)
        logits: FloatArray = x @ matrix.T + bias
        return logits

    def best(self, observations: FloatArray) -> IntArray:
        """The likeliest choices, ``(A, 5)``; none depends on the other karts, to the bit."""
        parts = np.split(self.logits(observations[:, None])[:, 0], SPLITS, axis=1)
        return np.stack([part.argmax(axis=1) for part in parts], axis=1)

    def seat(self) -> NoReturn:
        """What agents that older versions wrote call."""
        raise ConfigError(
            "this agent is of another version of stkzoo; make it again from its "
            "policy.safetensors with python -m stkzoo.agents.training.export"
        )

    def sample(self, observations: FloatArray, random: np.random.Generator) -> IntArray:
        """Choices drawn by their probabilities, ``(A, 5)``."""
        logits = self.logits(observations)
        noisy = logits + random.gumbel(size=logits.shape).astype(np.float32)
        parts = np.split(noisy, SPLITS, axis=1)
        return np.stack([part.argmax(axis=1) for part in parts], axis=1)


def is_network(weights: Mapping[str, FloatArray]) -> bool:
    """Whether a file's arrays are such a policy's, and not one's that chooses among plans."""
    return _LAST.format("weight") in weights


def _layer(
    weights: Mapping[str, FloatArray], pattern: str, number: int
) -> tuple[FloatArray, FloatArray]:
    names = [pattern.format(number, part) for part in ("weight", "bias")]
    matrix, bias = (np.asarray(weights.get(name, np.zeros((0, 0))), np.float32) for name in names)
    if matrix.ndim != 2:
        matrix = np.zeros((0, 0), np.float32)
    return matrix, bias.reshape(-1)


def load_driver(path: str | Path) -> MlpDriver:
    """Reads a policy's file.

    Raises:
        ConfigError: it cannot be read or holds something else.
    """
    return MlpDriver(load_weights(path), f"the weights {str(path)!r}")
