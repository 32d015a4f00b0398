"""The NumPy reference implementation of ``mlp.c``: the networks of drivers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]


class Mlp:
    """A multilayer perceptron in float32.

    Args:
        layers: matrix ``(inputs, outputs)`` and bias ``(outputs,)`` of each layer.
        is_tanh: whether tanh follows each layer except the last; otherwise a rectified linear unit
            does.

    Raises:
        ValueError: the shapes do not fit.
    """

    def __init__(self, layers: tuple[tuple[FloatArray, FloatArray], ...], is_tanh: bool) -> None:
        sizes = [len(bias) for _, bias in layers]
        wanted = [len(layers[0][0]), *sizes[:-1]] if layers else []
        if not layers or [matrix.shape for matrix, _ in layers] != [
            *zip(wanted, sizes, strict=True)
        ]:
            raise ValueError("there are no layers, or their shapes do not fit")
        self._layers, self._is_tanh = layers, is_tanh

    def evaluate(self, inputs: FloatArray, out: FloatArray) -> None:
        """Writes the outputs for rows of inputs; a row's outputs do not depend on other rows.

        Args:
            inputs: ``(A, F)``; the first columns are the network's inputs.
            out: ``(A, outputs)``.

        Raises:
            ValueError: the shapes do not fit.
        """
        x = inputs[:, None, : len(self._layers[0][0])]  # one matrix product per row
        *hidden, (matrix, bias) = self._layers
        for weights, offset in hidden:
            x = x @ weights + offset
            x = np.tanh(x) if self._is_tanh else np.maximum(x, 0)
        out[:] = (x @ matrix + bias)[:, 0]
