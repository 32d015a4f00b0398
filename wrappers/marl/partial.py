"""Partial observability: limits on distance and field of view."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from stkzoo._checks import check_number, unknown_name
from stkzoo.errors import ConfigError
from stkzoo.mdp.spaces import extras_of
from stkzoo.views.bases import RecordedWrapper
from stkzoo.wrappers.arguments import dict_space
from stkzoo.wrappers.observations import MOTION, refuse_polar

_SEEN = {"karts": ("karts_position",), "items": ("items_position", "items_type")}


class PartialObservations(gym.ObservationWrapper[Any, Any, Any], RecordedWrapper):
    """Hides karts and items outside a radius and a field of view.

    Put it around the ``full`` view, inside wrappers that fix sizes or flatten. Hidden objects are
    removed from the lists. It applies per agent, so agents of one race can have different limits.

    Args:
        env: an environment in the ``full`` view.
        radius: radius of vision [m].
        angle: total field of view [rad]; ``math.tau`` covers all directions.
        of: what to hide: ``"karts"``, ``"items"`` or both.

    Raises:
        ConfigError: an argument is invalid, or the environment is in another view.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        *,
        radius: float = math.inf,
        angle: float = math.tau,
        of: Sequence[str] = ("karts", "items"),
    ) -> None:
        super().__init__(env)
        space = dict_space(env.observation_space, "observations", "PartialObservations")
        self.radius = check_number("radius", radius, is_finite=False)
        self.angle = check_number("angle", angle, is_finite=False)
        for name in of:
            if name not in _SEEN:
                raise unknown_name("thing to see", name, _SEEN)
        motion = MOTION if "motion" in extras_of(space) else ()
        self._groups = [(*_SEEN[name], *(motion if name == "karts" else ())) for name in of]
        for key in (key for group in self._groups for key in group):
            if not isinstance(space.spaces.get(key), gym.spaces.Sequence):
                raise ConfigError(
                    f"PartialObservations needs a list (a Sequence space) under {key!r}, but found "
                    f"{space.spaces.get(key)!r}. Use it around the full view."
                )
        refuse_polar(space, "PartialObservations", "inside PolarObservations")

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Returns the observation without hidden objects."""
        changed = dict(observation)
        for keys in self._groups:
            if len(observation[keys[0]]):
                seen = self._is_seen(np.asarray(observation[keys[0]], np.float64))
                for key in keys:
                    pairs = zip(observation[key], seen, strict=True)
                    changed[key] = tuple(value for value, is_seen in pairs if is_seen)
        return changed

    def _is_seen(self, positions: Any) -> list[bool]:
        """Returns which of the positions ``(M, 3)`` in the kart's frame are visible."""
        side = np.abs(np.arctan2(positions[:, 0], positions[:, 2]))
        near = np.linalg.norm(positions, axis=-1) <= self.radius
        seen: list[bool] = (near & (side <= self.angle / 2)).tolist()
        return seen
