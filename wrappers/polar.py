"""Positions as angles and a distance."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from stkzoo.errors import ConfigError
from stkzoo.views.bases import BatchedWrapper
from stkzoo.wrappers.arguments import dict_space

__all__ = ["PolarObservations"]

_KEYS = ("center_path", "items_position", "karts_position", "paths_end", "paths_start")


class PolarObservations(gym.ObservationWrapper[Any, Any, Any], BatchedWrapper):
    """Turns positions in the kart frame into two angles and a distance.

    ``(x, y, z)`` [m], x right, y up, z forward, becomes ``(atan2(x, z), atan2(y, z),
    norm)`` [rad, rad, m], float32: 0 is straight ahead, a positive first angle is to the
    right, a positive second one above. Padding (zeros) stays zero. Keys: ``center_path``,
    ``items_position``, ``karts_position``, ``paths_start`` and ``paths_end``, those that
    the environment has; lists stay tuples.

    Raises:
        ConfigError: the environment has none of these keys.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        space = dict_space(env.observation_space, "observations", "PolarObservations")
        self._keys = tuple(key for key in _KEYS if key in space.spaces)
        if not self._keys:
            raise ConfigError(
                f"PolarObservations found no positions among {', '.join(space.spaces)}; "
                f"it changes {', '.join(_KEYS)}."
            )

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """The observation with polar positions; ``(..., 3)`` arrays keep their shape."""
        changed = dict(observation)
        for key in self._keys:
            value = observation[key]
            if not isinstance(value, tuple):
                changed[key] = _polar(np.asarray(value, np.float32))
            elif value:
                changed[key] = tuple(_polar(np.asarray(value, np.float32)))
        return changed


def _polar(positions: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """``(..., 3)`` positions [m] as angles [rad] and a distance [m]."""
    x, y, z = positions[..., 0], positions[..., 1], positions[..., 2]
    polar = np.empty_like(positions)
    polar[..., 0] = np.arctan2(x, z)
    polar[..., 1] = np.arctan2(y, z)
    polar[..., 2] = np.linalg.norm(positions, axis=-1)
    return polar
