"""A Stable-Baselines3 ``MlpPolicy`` on the view ``racing``, evaluated without PyTorch.

The file format is safetensors with the policy's state dict and its minimum steps of a drift. A
recurrent policy is the same with a memory as additional input, and the weights of the unit that
computes the memory (:mod:`.recurrent`).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from stkzoo.agents.planning import FloatArray, IntArray
from stkzoo.agents.planning.memory import MEMORY_SIZE
from stkzoo.agents.planning.network import Mlp
from stkzoo.errors import ConfigError
from stkzoo.wrappers.racing import CHOICES, CONTEST_SIZE, SIZE

from .action_filter import INPUT_SIZE
from .recurrent import GatedUnit, memory_size
from .weights import load_weights

#: Name of the view by the size of the input.
_VIEWS = {
    size + memory: view
    for view, size in (("racing", SIZE), ("contest", CONTEST_SIZE))
    for memory in (0, MEMORY_SIZE)
}
#: Names of the hidden layers and of the last one.
_HIDDEN, _LAST = "mlp_extractor.policy_net.{}", "action_net"
#: Boundaries between the logits of the choices.
SPLITS = np.cumsum(CHOICES)[:-1].tolist()
#: First logit of each choice, and the choice of each logit.
_BEGINS = np.array([0, *SPLITS])
_CHOICE_OF = np.repeat(np.arange(len(CHOICES)), CHOICES)
#: Name of the array with the minimum steps of a drift.
HOLD = "drift_hold"
_MAX_HOLD = 1000


class MlpDriver:
    """The policy network of a state dict, for any number of karts at once.

    Args:
        weights: a state dict with numpy arrays; arrays outside the policy network are ignored.
        name: name of the weights in error messages.

    Attributes:
        hold: minimum steps of a drift.
        inputs: size of the input: the view, usually the memory of the action filter, and the
            memory of a recurrent policy.
        unit: computes the memory of a recurrent policy; ``None`` without one.
        view: name of the view: ``"racing"`` or ``"contest"``.
        hidden: units of the hidden layers.

    Raises:
        ConfigError: the weights are not an ``MlpPolicy`` on the view ``racing``.
    """

    def __init__(self, weights: Mapping[str, FloatArray], name: str = "the weights") -> None:
        held = float(np.asarray(weights.get(HOLD, np.zeros(1))).sum())
        if not 0 <= held <= _MAX_HOLD:
            raise ConfigError(f"{name} have {HOLD} {held}, expected 0 to {_MAX_HOLD} steps")
        self.hold = int(held)
        names = map(_HIDDEN.format, itertools.count(0, 2))  # every second module is the tanh
        hidden = itertools.takewhile(lambda name: f"{name}.weight" in weights, names)
        layers = [_layer(weights, name) for name in (*hidden, _LAST)]
        shapes = [matrix.shape for matrix, _ in layers]
        size = memory_size(weights)
        seen = shapes[0][-1] - size if shapes[0][-1] - size in _VIEWS else INPUT_SIZE
        self.inputs, self.view = seen + size, _VIEWS[seen]
        self.unit = GatedUnit(weights, seen, name) if size else None
        sizes = [self.inputs, *(len(bias) for _, bias in layers)]
        wanted = list(zip(sizes[1:], sizes, strict=False))
        arrays = [array for layer in layers for array in layer]
        if (
            len(shapes) < 2
            or shapes != wanted
            or sizes[-1] != sum(CHOICES)
            or not all(np.isfinite(array).all() for array in arrays)
        ):
            raise ConfigError(
                f"{name} have layers of the shapes {shapes}, expected finite ones of a "
                f"Stable-Baselines3 MlpPolicy from the {SIZE} numbers of the view 'racing' or the "
                f"{CONTEST_SIZE} of 'contest', or {MEMORY_SIZE} more with what the action filter "
                f"remembers, to its {sum(CHOICES)} choices (mlp_extractor.policy_net.*, "
                "action_net.*)"
            )
        self.hidden = tuple(sizes[1:-1])
        self._mlp = Mlp([(matrix.T, bias) for matrix, bias in layers], True)

    def logits(self, observations: FloatArray) -> FloatArray:
        """Returns the logits of all choices, ``(A, 31)``; each row depends only on its own input.

        Args:
            observations: ``(A, F)`` float32; the first :attr:`inputs` columns are the input.
        """
        return self._mlp(observations)

    def best(self, observations: FloatArray, noise: FloatArray | float = 0.0) -> IntArray:
        """Returns the most likely choices, ``(A, 5)``; each row depends only on its own input.

        Args:
            observations: as for :meth:`logits`.
            noise: added to the logits; Gumbel noise ``(A, 31)`` samples from the probabilities.
        """
        logits = self.logits(observations) + np.float32(noise)
        parts = np.split(logits, SPLITS, axis=1)
        return np.stack([part.argmax(axis=1) for part in parts], axis=1)

    def sample(self, observations: FloatArray, random: np.random.Generator) -> IntArray:
        """Samples choices from their probabilities, ``(A, 5)``."""
        noise = random.gumbel(size=(len(observations), sum(CHOICES)))
        return self.best(observations, noise.astype(np.float32))


def log_probabilities(logits: FloatArray) -> FloatArray:
    """Returns the log-probability of each option of each choice.

    Args:
        logits: ``(..., 31)``.
    """
    top = np.maximum.reduceat(logits, _BEGINS, axis=-1)
    odds = np.exp(logits - top[..., _CHOICE_OF])
    normalizer = top + np.log(np.add.reduceat(odds, _BEGINS, axis=-1))
    log_probabilities: FloatArray = logits - normalizer[..., _CHOICE_OF]
    return log_probabilities


def is_network(weights: Mapping[str, FloatArray]) -> bool:
    """Returns whether arrays are a network without plans, not a policy over plans."""
    return f"{_LAST}.weight" in weights


def _layer(weights: Mapping[str, FloatArray], layer: str) -> tuple[FloatArray, FloatArray]:
    matrix, bias = (
        np.asarray(weights.get(f"{layer}.{part}", np.zeros((0, 0))), np.float32)
        for part in ("weight", "bias")
    )
    if matrix.ndim != 2:
        matrix = np.zeros((0, 0), np.float32)
    return matrix, bias.reshape(-1)


def load_driver(path: str | Path) -> MlpDriver:
    """Reads the file of a policy.

    Raises:
        ConfigError: the file is unreadable or has other content.
    """
    return MlpDriver(load_weights(path), f"the weights {str(path)!r}")
