"""The networks of the reference algorithms, in PyTorch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.pretrained.mlp import SPLITS
from stkzoo.mdp import GLOBAL_FEATURES, KART_FEATURES
from stkzoo.wrappers.racing import CHOICES, SIZE

from ..common.learner import FloatArray, Weights
from ..common.network_policy import FIRST_BIASES
from ..common.ppo import PPONetwork
from .actor import critic_inputs

#: Values that the state's features are divided by: typical ones of a race.
_GLOBAL_UNITS = {"time": 60.0, "phase": 4.0, "track_length": 500.0, "laps": 1.0}
_KART_UNITS = {
    "location": 100.0,
    "rotation": 1.0,
    "velocity": 20.0,
    "angular_velocity": 2.0,
    "speed": 20.0,
    "energy": 5.0,
    "skeed_factor": 1.0,
    "shield_time": 5.0,
    "attachment_type": 5.0,
    "attachment_time_left": 10.0,
    "powerup_type": 5.0,
    "powerup_num": 2.0,
    "node": 100.0,
    "position": 5.0,
    "finished_laps": 1.0,
    "has_finished_race": 1.0,
    "finish_time": 60.0,
    "distance": 500.0,
}


class TaskNetwork(PPONetwork):
    """A policy and a value network on the view ``racing``, with their optimizer.

    See :class:`..common.ppo.PPONetwork`. In files, the policy's layers have the names of
    Stable-Baselines3, so that commands that read its policies can read these.

    Args:
        hidden: units of the hidden layers of both.
        seed: seed of the initial weights.
        state_size: size of the race's state, which the value network sees too; 0 for none.

    Raises:
        ConfigError: PyTorch is not installed.
    """

    def __init__(self, hidden: Sequence[int], seed: int, state_size: int = 0) -> None:
        value_sizes = SIZE + state_size, *hidden, 1
        super().__init__(seed, (SIZE, *hidden, sum(CHOICES)), value_sizes, "Tanh")
        with self.torch.no_grad():
            for logit, bias in FIRST_BIASES.items():
                self.policy[-1].bias[logit] += bias
        if state_size:
            self.scale[SIZE:] = 1.0 / _state_units(state_size)

    def tensors(self, seen: npt.NDArray[np.void]) -> list[Any]:
        """Returns inputs ``(N, F)``, those of the value network, scaled, and choices ``(N, 5)``."""
        central = self.normalized(critic_inputs(seen))
        arrays = seen["inputs"].copy(), central, seen["choices"].copy()
        return [self.torch.from_numpy(array) for array in arrays]

    def evaluate(self, columns: Sequence[Any]) -> tuple[Any, Any, Any, Any]:
        """See :class:`..common.ppo.PPONetwork`; there is no penalty."""
        inputs, central, choices = columns
        parts = self.policy(inputs).tensor_split(SPLITS, dim=1)
        log_probability, entropy = 0.0, 0.0
        for number, logits in enumerate(parts):
            logs = self.torch.log_softmax(logits, dim=1)
            chosen = logs.gather(1, choices[:, number : number + 1])[:, 0]
            log_probability = log_probability + chosen
            entropy = entropy - (logs.exp() * logs).sum(1)
        penalty = self.torch.zeros(1)
        return log_probability, entropy, penalty, self.value(central)[:, 0]

    def weights(self) -> tuple[Weights, Weights]:
        """See :class:`..common.learner.LearningNetwork`."""
        policy = {name: array.detach().numpy().copy() for name, array in self._named().items()}
        return policy, self.arrays(self.value)

    def copy(self, weights: Weights) -> None:
        """Copies weights of another policy, in the form of the first result of :meth:`weights`."""
        with self.torch.no_grad():
            for name, array in self._named().items():
                array.copy_(self.torch.from_numpy(weights[name]))

    def _named(self) -> dict[str, Any]:
        """Returns the policy's tensors by their names in files."""
        names = [f"mlp_extractor.policy_net.{n}" for n in range(0, len(self.policy) - 1, 2)]
        return {
            f"{name}.{part}": getattr(layer, part)
            for name, layer in zip([*names, "action_net"], self.policy[::2], strict=True)
            for part in ("weight", "bias")
        }


def _state_units(state_size: int) -> FloatArray:
    """Returns the values that the entries of a race's state are divided by, ``(state_size,)``."""
    general = [_GLOBAL_UNITS[name] for name in GLOBAL_FEATURES]
    kart = [_KART_UNITS[name] for name, size in KART_FEATURES for _ in range(size)]
    num_kart = (state_size - len(general)) // len(kart)
    return np.array(general + num_kart * kart, np.float32)
