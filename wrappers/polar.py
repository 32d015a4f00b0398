"""Positions as angles and a distance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from stkzoo.errors import ConfigError
from stkzoo.mdp.geometry import to_polar
from stkzoo.views.bases import CompiledWrapper
from stkzoo.wrappers.arguments import dict_space

if TYPE_CHECKING:
    from stkzoo.views.plan import ViewPlan

__all__ = ["PolarObservations"]

_KEYS = ("center_path", "items_position", "karts_position", "paths_end", "paths_start")


class PolarObservations(gym.ObservationWrapper[Any, Any, Any], CompiledWrapper):
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

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if plan.is_polar or plan.is_flat or plan.observer:
            return False
        plan.is_polar = True
        return True

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """The observation with polar positions; ``(..., 3)`` arrays keep their shape."""
        changed = dict(observation)
        for key in self._keys:
            value = observation[key]
            if not isinstance(value, tuple):
                changed[key] = to_polar(np.asarray(value, np.float32))
            elif value:
                changed[key] = tuple(to_polar(np.asarray(value, np.float32)))
        return changed
