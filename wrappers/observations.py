"""Wrappers that give observations a fixed size and polar coordinates."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo._checks import check_flag, check_whole, shortened
from stkzoo.errors import ConfigError
from stkzoo.kernel import to_polar
from stkzoo.mdp.spaces import extras_of
from stkzoo.views.bases import CompiledWrapper, dict_space

if TYPE_CHECKING:
    from stkzoo.views.plan import ViewPlan

_LISTS = {
    "paths": ("paths_width", "paths_distance", "paths_start", "paths_end"),
    "items": ("items_position", "items_type"),
    "karts": ("karts_position",),
}
#: Entries for the motion of other karts, if the environment provides them.
MOTION = ("karts_velocity", "karts_heading")
#: Entries with positions, which :class:`PolarObservations` converts.
POSITIONS = ("center_path", "items_position", "karts_position", "paths_end", "paths_start")


class ConstantSizedObservations(gym.ObservationWrapper[Any, Any, Any], CompiledWrapper):
    """Truncates or zero-pads the lists of an observation to a fixed number of entries.

    ``paths_distance`` becomes ``(state_paths, 2)``, ``paths_width`` ``(state_paths, 1)``,
    ``paths_start`` and ``paths_end`` ``(state_paths, 3)``, ``items_position`` ``(state_items, 3)``
    and ``karts_position`` ``(state_karts, 3)``, all float32 with the units and frames of the
    ``full`` view; ``items_type`` becomes ``(state_items,)`` int64. With ``karts_motion``,
    ``karts_velocity`` ``(state_karts, 3)`` is the velocity of these karts over the ground in the
    observing kart's frame [m/s], and ``karts_heading`` ``(state_karts, 1)`` their heading relative
    to the observing kart, positive to the right [rad].

    Args:
        env: an environment in the ``full`` view.
        state_items: number of items.
        state_karts: number of other karts.
        state_paths: number of track segments.
        add_mask: add ``paths_mask``, ``items_mask`` and ``karts_mask``: int8, 1 for real entries
            and 0 for padding.
        karts_motion: keep the motion of the other karts, which the environment must provide.

    Raises:
        ConfigError: a number is below 1, or the environment does not have these lists.
    """

    left_out: ClassVar = {"make_tensor": "use observation"}

    def __init__(
        self,
        env: gym.Env[Any, Any],
        *,
        state_items: int = 5,
        state_karts: int = 5,
        state_paths: int = 5,
        add_mask: bool = False,
        karts_motion: bool = False,
    ) -> None:
        self.state_items = check_whole("state_items", state_items, 1)
        self.state_karts = check_whole("state_karts", state_karts, 1)
        self.state_paths = check_whole("state_paths", state_paths, 1)
        self.add_mask = check_flag("add_mask", add_mask)
        self.karts_motion = check_flag("karts_motion", karts_motion)
        super().__init__(env)
        motion = MOTION if self.karts_motion else ()
        self._lists = {**_LISTS, "karts": (*_LISTS["karts"], *motion)}
        self._sizes = {
            "paths": self.state_paths,
            "items": self.state_items,
            "karts": self.state_karts,
        }
        self._space = self._constant_space(
            dict_space(env.observation_space, "observations", "ConstantSizedObservations")
        )
        self.observation_space = self._space

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if plan.sizes or plan.is_flat or plan.observer:
            return False
        plan.sizes = dict(self._sizes)
        plan.parts = {name: name for name in self._space.spaces}
        return True

    def _constant_space(self, space: spaces.Dict) -> spaces.Dict:
        entries = copy.deepcopy(space.spaces)
        if not self.karts_motion:
            entries = {key: entry for key, entry in entries.items() if key not in MOTION}
        elif "motion" not in extras_of(space):
            raise ConfigError(
                "karts_motion needs an environment that observes how the other karts move. Choose "
                "a view with the option, such as view=('simple', {'karts_motion': True}), or give "
                "the function that is your view an attribute sees_motion that is true"
            )
        for group, size in self._sizes.items():
            for key in self._lists[group]:
                entries[key] = _repeated(key, entries.get(key), size)
            if self.add_mask:
                entries[f"{group}_mask"] = spaces.Box(0, 1, shape=(size,), dtype=np.int8)
        return spaces.Dict(entries)

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Returns the observation with fixed-size arrays in place of lists."""
        changed = {key: observation[key] for key in observation if key not in MOTION}
        for group, keys in self._lists.items():
            for key in keys:
                changed[key], length = _resized(observation[key], self._space[key])
            if self.add_mask:
                mask = np.zeros(self._sizes[group], np.int8)
                mask[:length] = 1
                changed[f"{group}_mask"] = mask
        return changed


class PolarObservations(gym.ObservationWrapper[Any, Any, Any], CompiledWrapper):
    """Converts positions in the kart frame to two angles and a distance.

    ``(x, y, z)`` [m] with x right, y up and z forward becomes ``(atan2(x, z), atan2(y, z), norm)``
    [rad, rad, m], float32. Angle 0 is straight ahead; the first angle is positive to the right, the
    second one upwards. Zero padding stays zero. The wrapper converts ``center_path``,
    ``items_position``, ``karts_position``, ``paths_start`` and ``paths_end``, if the environment
    has them; lists stay tuples.

    Args:
        env: an environment in the ``full`` view, perhaps with fixed sizes.

    Raises:
        ConfigError: the environment has none of these keys, or they are polar already.
    """

    left_out: ClassVar = dict.fromkeys(("KEYS", "SIMPLE_KEYS"), "its documentation lists the keys")

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        space = dict_space(env.observation_space, "observations", "PolarObservations")
        self._keys = tuple(key for key in POSITIONS if key in space.spaces)
        if not self._keys:
            raise ConfigError(
                f"PolarObservations found no positions among {', '.join(space.spaces)}; "
                f"it changes {', '.join(POSITIONS)}."
            )
        refuse_polar(env, "PolarObservations", "only once")

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if plan.is_polar or plan.is_flat or plan.observer:
            return False
        plan.is_polar = True
        return True

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Returns the observation with polar positions; ``(..., 3)`` arrays keep their shape."""
        changed = dict(observation)
        for key in self._keys:
            value = observation[key]
            if not isinstance(value, tuple):
                changed[key] = to_polar(np.ascontiguousarray(value, np.float32))
            elif value:
                changed[key] = tuple(to_polar(np.ascontiguousarray(value, np.float32)))
        return changed


def inwards(env: Any) -> Iterator[Any]:
    """Yields an environment's wrappers, the outermost first."""
    while isinstance(env, gym.Wrapper):
        yield env
        env = env.env


def refuse_polar(env: gym.Env[Any, Any], wrapper: str, place: str) -> None:
    """Checks that the positions in an environment's observations are in meters.

    Args:
        env: the environment.
        wrapper: name of the wrapper, for the message.
        place: where to put it, for the message.

    Raises:
        ConfigError: positions are polar already.
    """
    if any(isinstance(inner, PolarObservations) for inner in inwards(env)):
        raise ConfigError(
            f"{wrapper} found PolarObservations inside it. Use it around a view with positions in "
            f"meters, such as full, and {place}."
        )


def _repeated(key: str, space: spaces.Space[Any] | None, size: int) -> spaces.Space[Any]:
    """Returns the space of a list with ``size`` entries."""
    entry = space.feature_space if isinstance(space, spaces.Sequence) else None
    if isinstance(entry, spaces.Discrete):
        return spaces.MultiDiscrete([entry.n] * size)
    if isinstance(entry, spaces.Box):
        low, high = (np.repeat(bound[None], size, axis=0) for bound in (entry.low, entry.high))
        return type(entry)(low, high, dtype=np.float32)
    raise ConfigError(
        f"ConstantSizedObservations needs a list (a Sequence space) under {key!r}. Use it around "
        f"the full view, and only once. Found {shortened(space)}"
    )


def _resized(value: Any, space: spaces.Space[Any]) -> tuple[npt.NDArray[Any], int]:
    """Returns a list as an array of the space's size, and the number of real entries."""
    resized = np.zeros(space.shape or (), space.dtype)
    length = min(len(value), len(resized))
    if length:  # an empty list has no vector length
        resized[:length] = value[:length]
    return resized, length
