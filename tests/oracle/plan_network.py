"""The NumPy implementation of ``agents/planning/network.c``: the networks of drivers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]


class Mlp:
    def __init__(self, layers: tuple[tuple[FloatArray, FloatArray], ...], is_tanh: bool) -> None:
        self._layers, self._is_tanh = layers, is_tanh

    def __call__(self, inputs: FloatArray) -> FloatArray:
        x = inputs[:, None, : len(self._layers[0][0])]  # one matrix product per row
        *hidden, (matrix, bias) = self._layers
        for weights, offset in hidden:
            x = x @ weights + offset
            x = np.tanh(x) if self._is_tanh else np.maximum(x, 0)
        outputs: FloatArray = (x @ matrix + bias)[:, 0]
        return outputs
