"""A Stable-Baselines3 policy as a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stkzoo.agents.planning.arrays import FloatArray
from stkzoo.agents.planning.memory import MEMORY_SIZE
from stkzoo.agents.pretrained.mlp import HOLD, MlpDriver
from stkzoo.agents.pretrained.weights import load_weights, save_weights
from stkzoo.errors import ConfigError
from stkzoo.wrappers.racing import SIZE


def save_driver(path: str | Path, policy: Any, hold: int = 0) -> None:
    """Writes a Stable-Baselines3 policy to a file atomically.

    Args:
        path: of the file.
        policy: its state dict is kept.
        hold: steps for which it holds a drift.
    """
    state = {name: value.detach().cpu().numpy() for name, value in policy.state_dict().items()}
    save_weights(path, state | ({HOLD: np.array([hold], np.float32)} if hold else {}))


def initial_weights(path: str | Path, policy: Any) -> dict[str, FloatArray]:
    """A state dict for a policy from a file, which may lack the weights of the value.

    If its layers see the view alone, what the action filter remembers has no effect at first.

    Args:
        path: a file that ``sb3``, ``imitation`` or ``rllib`` wrote.
        policy: the Stable-Baselines3 policy that starts from it.

    Raises:
        ConfigError: the file is unreadable, or is of another network.
    """
    weights = load_weights(path)
    MlpDriver(weights, f"the weights {str(path)!r}")
    weights = {name: array for name, array in weights.items() if name != HOLD}
    own = {name: value.detach().cpu().numpy() for name, value in policy.state_dict().items()}
    for name, array in weights.items():
        more = own[name].shape[-1] - array.shape[-1] if name in own and array.ndim == 2 else 0
        if array.shape[-1] == SIZE and more == MEMORY_SIZE:
            weights[name] = np.pad(array, ((0, 0), (0, more)))
    others = [n for n, array in weights.items() if n not in own or own[n].shape != array.shape]
    if others:
        raise ConfigError(
            f"the weights {str(path)!r} are of another network: {', '.join(others)} do not fit "
            "this one; give the --hidden that they were made with"
        )
    return {**own, **weights}
