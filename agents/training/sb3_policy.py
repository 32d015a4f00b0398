"""A Stable-Baselines3 policy in numpy, as a file, and as an agent to race.

The policy is an ``MlpPolicy`` of tanh layers on the view ``racing``; a file of it is a
safetensors file of its state dict, and of how long it holds a drift if it does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.pretrained.weights import load_weights, save_weights
from stkzoo.errors import ConfigError
from stkzoo.whole_file import whole_file
from stkzoo.wrappers.racing import CHOICES, RESCUE, SIZE

__all__ = [
    "MlpDriver",
    "Reflexes",
    "Seat",
    "load_driver",
    "save_driver",
    "start_weights",
    "write_agent",
]

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]

_LAYER = "mlp_extractor.policy_net.{}.{}"
_LAST = "action_net.{}"
_SPLITS = np.cumsum(CHOICES)[:-1].tolist()
#: The columns of choices that are the pedal and the drift.
_PEDAL, _DRIFT = 1, 2
#: Where the view has the speed forwards [20 m/s].
_SPEED = 2
#: A kart slower than this [20 m/s] for so many steps is stuck.
_STILL, _STUCK_STEPS = 3.0 / 20.0, 20
#: Under this name a file says for how many steps a drift is held.
_HOLD = "drift_hold"

#: Chooses for one kart at a time: choices ``(1, 5)`` by its view ``(1, 165)``; it may remember.
Seat = Callable[[FloatArray], IntArray]

_MODULE = '''"""A driver learned by self-play with Stable-Baselines3."""

from pathlib import Path

from stkzoo.agents.training.sb3_policy import load_driver

env_name = "supertuxkart/racing-v0"
player_name = {name!r}
driver = load_driver(Path(__file__).with_name("policy.safetensors"))


def create_state():
    return driver.seat()


def get_actor(module_dir, observation_space, action_space):
    return lambda seat, observation: seat(observation[None])[0]
'''


class Reflexes:
    """What some karts do without deciding: they hold drifts, and call for the rescue when stuck.

    A drift pays after a second. Who decides anew in each step whether to go on with it, by chance,
    never comes so far, and never learns it. And who is stuck by its likeliest choice stays so.

    Args:
        karts: how many.
        hold: for how many steps a drift goes on once it has begun; 0 or 1 leaves it to the choices.
    """

    def __init__(self, karts: int, hold: int) -> None:
        self._hold = hold
        self._left, self._still = np.zeros(karts, np.int64), np.zeros(karts, np.int64)
        self._drifts, self._has_moved = np.zeros(karts, np.bool_), np.zeros(karts, np.bool_)

    def apply(self, choices: npt.NDArray[Any], views: FloatArray) -> IntArray:
        """What is done of one step's choices.

        Args:
            choices: ``(karts, 5)``.
            views: ``(karts, 165)``, by which they were made.
        """
        done = np.array(choices, np.int64)
        is_asked = done[:, _DRIFT] == 1
        begins = is_asked & ~self._drifts
        self._left = np.where(begins, self._hold, self._left) - 1
        self._drifts = is_asked | (self._left >= 0)
        done[:, _DRIFT] = self._drifts
        is_slow = np.abs(views[:, _SPEED]) < _STILL
        self._has_moved |= ~is_slow  # on the grid all stand still
        self._still = np.where(is_slow & self._has_moved, self._still + 1, 0)
        is_stuck = self._still >= _STUCK_STEPS
        done[is_stuck, _PEDAL] = RESCUE
        self._still[is_stuck] = 0
        return done

    def forget(self, karts: slice) -> None:
        """Begins some karts anew."""
        self._left[karts] = self._still[karts] = 0
        self._drifts[karts] = self._has_moved[karts] = False


class MlpDriver:
    """The policy's part of a state dict, for any number of karts at once.

    Args:
        weights: a state dict, its arrays in numpy; what is not the policy's is left alone.
        name: what errors call it.

    Attributes:
        hold: for how many steps it holds a drift.

    Raises:
        ConfigError: they are not of an ``MlpPolicy`` on the view ``racing``.
    """

    def __init__(self, weights: Mapping[str, FloatArray], name: str = "the weights") -> None:
        self.hold = int(np.asarray(weights.get(_HOLD, np.zeros(1))).sum())
        self._layers: list[tuple[FloatArray, FloatArray]] = []
        number = 0
        while _LAYER.format(number, "weight") in weights:
            self._layers.append(_layer(weights, _LAYER, number))
            number += 2  # every other one is the tanh
        if _LAST.format("weight") in weights:
            self._layers.append(_layer(weights, "action_net.{1}", 0))
        sizes = [SIZE, *(len(bias) for _, bias in self._layers)]
        found = [matrix.shape for matrix, _ in self._layers]
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
                f"Stable-Baselines3 MlpPolicy from the {SIZE} numbers of the view 'racing' to its "
                f"{sum(CHOICES)} choices (mlp_extractor.policy_net.*, action_net.*)"
            )

    def logits(self, observations: FloatArray) -> FloatArray:
        """Those of all choices, ``(A, 31)``, of observations ``(A, 165)``."""
        x = np.asarray(observations, np.float32)
        *hidden, (matrix, bias) = self._layers
        for weights, offset in hidden:
            x = np.tanh(x @ weights.T + offset)
        logits: FloatArray = x @ matrix.T + bias
        return logits

    def best(self, observations: FloatArray) -> IntArray:
        """The likeliest choices, ``(A, 5)``."""
        parts = np.split(self.logits(observations), _SPLITS, axis=1)
        return np.stack([part.argmax(axis=1) for part in parts], axis=1)

    def seat(self) -> Seat:
        """Drives one kart through one race by the likeliest choices."""
        reflexes = Reflexes(1, self.hold)
        return lambda view: reflexes.apply(self.best(view), view)

    def sample(self, observations: FloatArray, random: np.random.Generator) -> IntArray:
        """Choices drawn by their probabilities, ``(A, 5)``."""
        logits = self.logits(observations)
        noisy = logits + random.gumbel(size=logits.shape).astype(np.float32)
        parts = np.split(noisy, _SPLITS, axis=1)
        return np.stack([part.argmax(axis=1) for part in parts], axis=1)


def _layer(
    weights: Mapping[str, FloatArray], pattern: str, number: int
) -> tuple[FloatArray, FloatArray]:
    names = [pattern.format(number, part) for part in ("weight", "bias")]
    matrix, bias = (np.asarray(weights.get(name, np.zeros((0, 0))), np.float32) for name in names)
    return matrix, bias.reshape(-1)


def load_driver(path: str | Path) -> MlpDriver:
    """Reads a policy's file.

    Raises:
        ConfigError: it cannot be read or holds something else.
    """
    return MlpDriver(load_weights(path), f"the weights {str(path)!r}")


def save_driver(path: str | Path, policy: Any, hold: int = 0) -> None:
    """Writes a Stable-Baselines3 policy to a file, whole or not at all.

    Args:
        path: of the file.
        policy: its state dict is kept.
        hold: for how many steps it holds a drift.
    """
    state = {name: value.detach().cpu().numpy() for name, value in policy.state_dict().items()}
    save_weights(path, state | ({_HOLD: np.array([hold], np.float32)} if hold else {}))


def start_weights(path: str | Path, policy: Any) -> dict[str, FloatArray]:
    """A state dict for a policy from a file, which may lack the value's part.

    Args:
        path: of the file; ``imitate`` and ``sb3_selfplay`` write such.
        policy: the Stable-Baselines3 policy that shall start from it.

    Raises:
        ConfigError: it cannot be read, or is of another policy.
    """
    weights = load_weights(path)
    MlpDriver(weights, f"the weights {str(path)!r}")
    weights = {name: array for name, array in weights.items() if name != _HOLD}
    own = {name: value.detach().cpu().numpy() for name, value in policy.state_dict().items()}
    others = [n for n, array in weights.items() if n not in own or own[n].shape != array.shape]
    if others:
        raise ConfigError(
            f"the weights {str(path)!r} are of another network: {', '.join(others)} have no place "
            "in this one; give the --hidden that they were made with"
        )
    return {**own, **weights}


def write_agent(folder: str | Path, policy: Any, name: str, hold: int = 0) -> Path:
    """Makes an agent of a policy: a folder that ``stkzoo race`` takes.

    Args:
        folder: which is made.
        policy: of Stable-Baselines3.
        name: of the agent.
        hold: for how many steps it holds a drift.

    Returns:
        The folder.
    """
    path = Path(folder)
    path.mkdir(parents=True, exist_ok=True)
    save_driver(path / "policy.safetensors", policy, hold)
    with whole_file(path / "pystk_actor.py") as part:
        part.write_text(_MODULE.format(name=name))
    return path
