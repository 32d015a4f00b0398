"""Observations for research: masks of actions, and limits on distance and field of view."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo._checks import check_name, check_number, shortened
from stkzoo.errors import ConfigError
from stkzoo.kernel import action_mask
from stkzoo.mdp.spaces import extras_of
from stkzoo.views.bases import (
    ActionObservationWrapper,
    CompiledWrapper,
    RecordedWrapper,
    dict_space,
)
from stkzoo.wrappers.flattening import FlattenerWrapper
from stkzoo.wrappers.observations import MOTION, inwards, refuse_polar

if TYPE_CHECKING:
    from stkzoo.views.plan import ViewPlan


class ActionMasks(gym.ObservationWrapper[Any, Any, Any], CompiledWrapper):
    """Adds ``action_mask`` to a flattened view: 1 for actions that have an effect, otherwise 0.

    Nitro has no effect with an empty tank, and fire has none without a powerup; actions with such a
    button are masked.
    Masked actions are still valid: the race ignores the button.

    The mask is int8, ``(n,)`` for ``Discrete(n)``. For ``MultiDiscrete``, the masks of all choices
    are concatenated, ``(sum(nvec),)``, as ``MaskablePPO`` expects.

    Args:
        env: an environment with flattened observations and discrete actions:
            ``flattened_multidiscrete`` or ``flattened_discrete``.

    Raises:
        ConfigError: the environment has another form.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        flattener = next((w for w in inwards(env) if isinstance(w, FlattenerWrapper)), None)
        space = env.observation_space
        if (
            flattener is None
            or not isinstance(space, spaces.Dict)
            or not {"continuous", "discrete"} <= set(space.spaces)
            or not isinstance(env.action_space, (spaces.Discrete, spaces.MultiDiscrete))
        ):
            raise ConfigError(
                "ActionMasks wraps flattened_multidiscrete or flattened_discrete. Found "
                f"observations {shortened(space)} and actions {env.action_space!r:.200}"
            )
        parts = flattener.observation_flattener.parts
        self._energy = _place(parts["continuous"], "energy")
        self._powerup = _place(parts["discrete"], "powerup_type")
        self._uses = _uses(env, flattener)
        mask = spaces.Box(0, 1, self._uses.shape[1:], np.int8)
        self.observation_space = spaces.Dict({**copy.deepcopy(space.spaces), "action_mask": mask})
        self._keys = tuple(self.observation_space.spaces)

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if not plan.is_flat or plan.ones or plan.uses is not None:
            return False
        plan.uses, plan.parts["action_mask"] = self._uses, "action_mask"
        return True

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Returns the observation with the mask, ``(n,)`` int8."""
        energy = observation["continuous"][self._energy]
        powerup = observation["discrete"][self._powerup]
        mask = action_mask(energy, powerup, self._uses)
        seen = {**observation, "action_mask": mask}
        return {key: seen[key] for key in self._keys}


def _place(parts: Mapping[str, spaces.Space[Any]], key: str) -> int:
    """Returns the index of a key's single value in the flattened vector of some parts."""
    keys = list(parts)
    if key not in keys:
        raise ConfigError(
            f"ActionMasks needs {key!r} among the observations, but found {', '.join(keys)}."
        )
    return sum(math.prod(parts[before].shape or ()) for before in keys[: keys.index(key)])


def _uses(env: gym.Env[Any, Any], flattener: FlattenerWrapper) -> npt.NDArray[np.bool_]:
    """Returns whether each action, or value of a choice, presses nitro, and fires: ``(2, n)``."""
    if isinstance(env.action_space, spaces.Discrete):
        action: Any = np.arange(env.action_space.n)
        for wrapper in inwards(env):
            if isinstance(wrapper, ActionObservationWrapper):
                action = wrapper.action(action)
            if wrapper is flattener:
                break
        return np.stack([action["nitro"], action["fire"]]) > 0
    inner: Any = flattener.env.action_space
    sizes = {key: int(inner[key].n) for key in flattener.action_flattener.discrete_keys}
    uses = [
        np.concatenate([(np.arange(size) > 0) & (key == button) for key, size in sizes.items()])
        for button in ("nitro", "fire")
    ]
    return np.stack(uses)


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
            check_name("thing to see", name, _SEEN)
        motion = MOTION if "motion" in extras_of(space) else ()
        self._groups = [(*_SEEN[name], *(motion if name == "karts" else ())) for name in of]
        for key in (key for group in self._groups for key in group):
            if not isinstance(space.spaces.get(key), gym.spaces.Sequence):
                raise ConfigError(
                    f"PartialObservations needs a list (a Sequence space) under {key!r}, but found "
                    f"{space.spaces.get(key)!r}. Use it around the full view."
                )
        refuse_polar(env, "PartialObservations", "inside PolarObservations")

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
