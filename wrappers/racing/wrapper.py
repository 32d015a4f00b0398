"""The wrappers of the racing view."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo._checks import shortened
from stkzoo.engine.snapshot import CONTROLS
from stkzoo.errors import ConfigError
from stkzoo.mdp.spaces import action_of
from stkzoo.views.bases import ActionFormWrapper, CompiledWrapper, dict_space
from stkzoo.wrappers.observations import refuse_polar
from stkzoo.wrappers.racing.features import CONTEST_SIZE, SIZE
from stkzoo.wrappers.racing.surroundings import (
    MAX_SEGMENTS,
    racing_features,
    road_observer,
    surroundings_of,
)

if TYPE_CHECKING:
    from stkzoo.kernel import KartObserver
    from stkzoo.views.plan import ObservationSource, ViewPlan

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]

_RIGHT = (0.05, 0.1, 0.16, 0.23, 0.31, 0.4, 0.52, 0.66, 0.82, 1.0)
#: Steering values of the choices, symmetric, so that reversing the order mirrors left and right.
STEERS = np.array([*(-steer for steer in reversed(_RIGHT)), 0.0, *_RIGHT], np.float32)

#: Choices of the pedal.
PEDALS = ("go", "coast", "brake", "rescue")
_GO, _COAST, BRAKE, RESCUE = range(len(PEDALS))
#: Names of the choices, in order, and the number of values of each.
CHOICE_NAMES = ("steer", "pedal", "drift", "nitro", "fire")
CHOICES = (len(STEERS), len(PEDALS), 2, 2, 2)

_NEEDED = ("paths_start", "paths_end", "paths_width", "items_position", "karts_position")


class RacingObservations(gym.ObservationWrapper[Any, Any, Any], CompiledWrapper):
    """Observes the race as one vector of fixed size, with values of about -1 to 1.

    The road ahead is sampled at fixed distances, because the lengths of segments differ between
    tracks. :data:`stkzoo.wrappers.racing.PARTS` describes the layout. If the view includes the game
    AI's ``action``, the observation is a dict of ``action`` and of the vector under
    ``observation``.

    Args:
        env: an environment in the ``full`` view.

    Raises:
        ConfigError: the environment is in another view.
    """

    _size, _extras = SIZE, frozenset[str]()

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        space = env.observation_space
        if not isinstance(space, spaces.Dict) or any(
            not isinstance(space.spaces.get(key), spaces.Sequence) for key in _NEEDED
        ):
            raise ConfigError(
                "RacingObservations needs the full view. Put it inside all other wrappers. "
                f"Found {shortened(space)}"
            )
        refuse_polar(env, "RacingObservations", "not around PolarObservations")
        vector = spaces.Box(-5.0, 5.0, (self._size,), np.float32)
        self.observation_space = vector
        self._has_action = "action" in space.spaces
        if self._has_action:
            parts = {"observation": vector, "action": copy.deepcopy(space["action"])}
            self.observation_space = spaces.Dict(parts)

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if not plan.is_full(self._extras):
            return False
        plan.observer = _RacingObserver(plan.new_observer(), "standing" in self._extras)
        return True

    def observation(self, observation: dict[str, Any]) -> Any:
        """Returns the vector ``(SIZE,)`` float32, with the AI's action if there is one."""
        vector = self._vector(observation)
        if not self._has_action:
            return vector
        return {"action": observation["action"], "observation": vector}

    def _vector(self, observation: Mapping[str, Any]) -> FloatArray:
        vector: FloatArray = racing_features(surroundings_of(observation))[0]
        return vector


class ContestObservations(RacingObservations, CompiledWrapper):
    """:class:`RacingObservations`, followed by the standing in the race: rank, progress, rivals.

    :data:`stkzoo.mdp.spaces.STANDING` describes the standing.

    Args:
        env: an environment in the ``full`` view that observes the standing.

    Raises:
        ConfigError: the environment is in another view.
    """

    _size, _extras = CONTEST_SIZE, frozenset({"standing"})

    def _vector(self, observation: Mapping[str, Any]) -> FloatArray:
        return np.concatenate([super()._vector(observation), observation["standing"]])


class _RacingObserver:
    """Makes the vectors of several karts directly from the game's records."""

    def __init__(self, full: KartObserver, sees_standing: bool) -> None:
        self._full, self._sees_standing = full, sees_standing

    def observe_into(
        self, source: ObservationSource, karts: IntArray, rows: IntArray, batch: Any
    ) -> None:
        """See :class:`~stkzoo.views.plan.RowObserver`."""
        _, num_paths, _ = source.course
        if num_paths < min(MAX_SEGMENTS, source.track_map.num_nodes):  # the vector needs more
            seen = self._full.observe(*source.course, source.snapshot.data, karts)
            batch[rows, :SIZE] = racing_features(surroundings_of(seen))
        else:
            road_observer(source.track_map).observe_into(source.snapshot, karts, rows, batch)
        if self._sees_standing:
            source.standing_into(karts, rows, batch, SIZE)


class RacingActions(ActionFormWrapper, CompiledWrapper):
    """Replaces the game's actions by a few choices: steering, pedal, drift, nitro and fire.

    The pedal is go, coast, brake or rescue; the brake also reverses. :data:`CHOICES` has the number
    of values of each choice, and :data:`STEERS` the steering values. If the observation includes
    the game AI's ``action``, it is converted to the nearest choices.

    Args:
        env: an environment with the game's actions.

    Raises:
        ConfigError: the environment has other actions.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        space = dict_space(env.action_space, "actions", "RacingActions")
        if set(space.spaces) != set(CONTROLS) or not isinstance(space["steer"], spaces.Box):
            raise ConfigError(
                "RacingActions needs the game's own actions. Put it around the full view. "
                f"Found {shortened(space)}"
            )
        self._change_action_space(spaces.MultiDiscrete(np.array(CHOICES)))

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if plan.has_action or plan.leaves.keys() != set(CONTROLS):
            return False
        choices = np.zeros((max(CHOICES), len(CHOICES)), np.int64)
        choices[:, 1] = _COAST
        leaf = []
        for place, count in enumerate(CHOICES):
            chosen = choices[:count].copy()
            chosen[:, 0] = len(STEERS) // 2
            chosen[:, place] = range(count)
            leaf.append((0.0, count - 1.0, True, 0, controls_of_choices(chosen)))
        plan.leaves = {"": tuple(leaf)}
        return True

    def action(self, action: npt.NDArray[Any]) -> dict[str, Any]:
        """Returns the game's action."""
        return action_of(controls_of_choices(np.asarray(action)))

    def observed_action(self, action: Mapping[str, Any]) -> npt.NDArray[np.int64]:
        """Returns the choices nearest to an action."""
        return choices_of_action(action)


def choices_of_action(action: Mapping[str, Any]) -> npt.NDArray[np.int64]:
    """Returns the choices nearest to an action of the game, ``(..., 5)`` int64."""
    steer = np.asarray(action["steer"])
    is_rescued = np.asarray(action["rescue"]) > 0
    is_braking = np.asarray(action["brake"]) > 0
    is_going = np.asarray(action["acceleration"])[..., 0] > 0.5
    parts = [
        np.abs(steer - STEERS).argmin(axis=-1),
        np.select([is_rescued, is_braking, is_going], [RESCUE, BRAKE, _GO], _COAST),
        *(np.asarray(action[key]) for key in ("drift", "nitro", "fire")),
    ]
    return np.stack(parts, axis=-1).astype(np.int64)


def controls_of_choices(choices: npt.NDArray[Any]) -> FloatArray:
    """Returns the engine's controls for choices ``(..., 5)``: ``(..., 7)`` float32."""
    controls = np.zeros((*choices.shape[:-1], 7), np.float32)
    controls[..., 0] = choices[..., 1] == _GO
    controls[..., 1] = STEERS[choices[..., 0]]
    controls[..., 2] = choices[..., 1] == BRAKE
    controls[..., 3] = choices[..., 2]
    controls[..., 4] = choices[..., 4]
    controls[..., 5] = choices[..., 3]
    controls[..., 6] = choices[..., 1] == RESCUE
    return controls
