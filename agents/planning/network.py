"""Multilayer perceptrons: the networks of drivers, for any number of karts at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from . import FloatArray, _planning

#: The extension needs layers whose number of outputs is a multiple of this.
_BLOCK = 16
#: Activation functions of the extension.
_LINEAR, _TANH, _RECTIFIER = range(3)


class Mlp:
    """A multilayer perceptron in float32.

    The bits of a row's outputs depend neither on other rows nor on the processor.

    Args:
        layers: matrix ``(inputs, outputs)`` and bias ``(outputs,)`` of each layer, which fit
            together.
        is_tanh: whether tanh follows each layer except the last; otherwise a rectified linear unit
            does.
        ends_in_tanh: whether tanh also follows the last layer.
    """

    def __init__(
        self,
        layers: Sequence[tuple[FloatArray, FloatArray]],
        is_tanh: bool,
        *,
        ends_in_tanh: bool = False,
    ) -> None:
        hidden = _TANH if is_tanh else _RECTIFIER
        activations = [*[hidden] * (len(layers) - 1), _TANH if ends_in_tanh else _LINEAR]
        self._layers = [
            (_padded(matrix), _padded(bias[None])[0], activation)
            for (matrix, bias), activation in zip(layers, activations, strict=True)
        ]
        self._num_outputs = len(layers[-1][1])

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Returns outputs ``(A, outputs)`` for rows of inputs.

        Args:
            inputs: ``(A, F)``; the first columns are the network's inputs.

        Raises:
            ValueError: there are fewer columns than inputs.
        """
        rows = np.ascontiguousarray(inputs, np.float32)
        for matrix, bias, activation in self._layers:
            outputs = np.empty((len(rows), len(bias)), np.float32)
            _planning.compute_layer(matrix, bias, activation, rows, outputs)
            rows = outputs
        return np.ascontiguousarray(rows[:, : self._num_outputs])


def _padded(matrix: FloatArray) -> FloatArray:
    """Returns a matrix with additional columns of zeros, up to a whole block."""
    missing = -matrix.shape[1] % _BLOCK
    padded: FloatArray = np.pad(matrix, ((0, 0), (0, missing))).astype(np.float32, order="C")
    return padded
