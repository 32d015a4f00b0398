"""The memory of recurrent policies: a gated recurrent unit (GRU; Cho et al., 2014)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stkzoo.agents.planning import FloatArray
from stkzoo.agents.planning.network import Mlp
from stkzoo.errors import ConfigError

#: Names of the weights in files: of the layers from the input, and of those from the memory.
_SEEN, _KEPT = "memory.seen", "memory.kept"


class GatedUnit:
    """A gated recurrent unit, for any number of karts at once.

    The memory *h* follows from the input *x* and the memory before::

        r, z = (1 + tanh(W x + U h + b)) / 2
        n = tanh(V x + Y (r h) + c)
        h = z h + (1 - z) n

    Args:
        weights: a state dict: ``memory.seen.weight`` ``(3H, F)`` has *W* for *r*, *W* for *z*, and
            *V*; ``memory.seen.bias`` ``(3H,)`` has *b* and *c*; ``memory.kept.weight`` ``(3H, H)``
            has *U* and *Y*.
        inputs: size of the input, F.
        name: name of the weights in error messages.

    Attributes:
        size: size of the memory, H.

    Raises:
        ConfigError: the weights have other shapes, or are not finite.
    """

    def __init__(self, weights: Mapping[str, FloatArray], inputs: int, name: str) -> None:
        names = f"{_SEEN}.weight", f"{_SEEN}.bias", f"{_KEPT}.weight"
        arrays = [np.asarray(weights.get(n, np.zeros(0)), np.float32) for n in names]
        seen, bias, kept = arrays
        self.size = memory_size(weights)
        rows, shapes = 3 * self.size, [array.shape for array in arrays]
        wanted = [(rows, inputs), (rows,), (rows, self.size)]
        if shapes != wanted or not all(np.isfinite(array).all() for array in arrays):
            raise ConfigError(f"{name} have {names} of {shapes}, expected finite ones of {wanted}")
        matrix: FloatArray = np.concatenate([seen, kept], axis=1).T
        gates, news = slice(2 * self.size), slice(2 * self.size, rows)
        self._gates, self._news = (
            Mlp([(matrix[:, part], bias[part])], True, ends_in_tanh=True) for part in (gates, news)
        )

    def __call__(self, inputs: FloatArray, memory: FloatArray) -> FloatArray:
        """Returns the next memory, ``(A, H)``; each row depends only on its own inputs.

        Args:
            inputs: ``(A, F)`` float32.
            memory: ``(A, H)`` float32, the memory before.
        """
        gates = np.float32(0.5) * (1 + self._gates(np.concatenate([inputs, memory], axis=1)))
        reset, keep = gates[:, : self.size], gates[:, self.size :]
        news = self._news(np.concatenate([inputs, reset * memory], axis=1))
        following: FloatArray = keep * memory + (1 - keep) * news
        return following


def memory_size(weights: Mapping[str, FloatArray]) -> int:
    """Returns the size of the memory of a policy; 0 without memory."""
    size: int = np.atleast_1d(weights.get(f"{_KEPT}.weight", np.zeros(0))).shape[-1]
    return size
