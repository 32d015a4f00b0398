"""Trained networks as agents in folders, which need numpy alone."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._os import atomic_write, write_text

_ACTOR = '''"""A trained network, evaluated with numpy."""

import numpy as np

env_name = "supertuxkart/{view}-v0"
player_name = {name!r}


def get_actor(module_dir, observation_space, action_space):
    data = np.load(module_dir / "policy.npz")
    layers = [(data[f"weights{{n}}"], data[f"bias{{n}}"]) for n in range(len(data.files) // 2)]

    def act(state, observation):
        values = np.ravel(observation)
        for weights, bias in layers[:-1]:
            values = np.{activation}
        weights, bias = layers[-1]
        values = weights @ values + bias
        return {action}

    return act
'''
#: The supported activations by the names of torch's classes, as expressions of numpy.
ACTIVATIONS = {
    "Tanh": "tanh(weights @ values + bias)",
    "ReLU": "maximum(weights @ values + bias, 0)",
}


def write_mlp_agent(
    folder: str | os.PathLike[str],
    layers: Sequence[tuple[npt.ArrayLike, npt.ArrayLike]],
    *,
    view: str,
    name: str,
    activation: str,
    action: str,
) -> str:
    """Writes a ``pystk_actor.py`` that evaluates a network, and the network's weights.

    Args:
        folder: the agent's folder, created if necessary. Existing files of the same names are
            replaced.
        layers: weights ``(outputs, inputs)`` and bias ``(outputs,)`` of each layer.
        view: name of the agent's view.
        name: the agent's ``player_name``.
        activation: a key of :data:`ACTIVATIONS`, for all layers but the last.
        action: Python expression of the action. ``values`` has the outputs of the last layer.

    Returns:
        The folder.
    """
    arrays: dict[str, Any] = {}
    for number, (weights, bias) in enumerate(layers):
        arrays |= {f"weights{number}": np.asarray(weights), f"bias{number}": np.asarray(bias)}
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    with atomic_write(target / "policy.npz") as part, part.open("wb") as file:
        np.savez(file, **arrays)
    text = _ACTOR.format(view=view, name=name, activation=ACTIVATIONS[activation], action=action)
    write_text(target / "pystk_actor.py", text)
    return str(target)
