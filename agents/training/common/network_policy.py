"""Networks on the racing view: their initial biases, and files of Stable-Baselines3 policies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stkzoo.agents.planning import FloatArray
from stkzoo.agents.planning.memory import MEMORY_SIZE
from stkzoo.agents.pretrained.mlp import HOLD, MlpDriver
from stkzoo.agents.pretrained.weights import load_weights, save_weights
from stkzoo.errors import ConfigError
from stkzoo.wrappers.racing import CHOICES, RESCUE, SIZE

#: Initial biases by index of the logit: prefer going to braking, and rarely drift or call the
#: rescue. Without them, karts stand still for most of their first races.
FIRST_BIASES = {CHOICES[0]: 1.5, CHOICES[0] + RESCUE: -3.0, sum(CHOICES[:2]): 2.0}


def save_driver(path: str | Path, policy: Any, hold: int = 0) -> None:
    """Writes a Stable-Baselines3 policy to a file atomically.

    Args:
        path: path of the file.
        policy: the policy, whose state dict is saved.
        hold: minimum steps of its drifts.
    """
    state = {name: value.detach().cpu().numpy() for name, value in policy.state_dict().items()}
    save_weights(path, state | ({HOLD: np.array([hold], np.float32)} if hold else {}))


def initial_weights(path: str | Path, policy: Any) -> dict[str, FloatArray]:
    """Returns a state dict for a policy from a file, which may lack the value network.

    If the layers in the file take only the view as input, the memory of the action filter initially
    has no effect.

    Args:
        path: a file from ``sb3``, ``imitation`` or ``rllib``.
        policy: the Stable-Baselines3 policy to initialize.

    Raises:
        ConfigError: the file is unreadable, or contains another network.
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
