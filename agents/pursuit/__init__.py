"""Pure pursuit by speed and steering angle: a short driver in physical units.

It drives on the arc through the kart and a point of the road ahead, as fast as the curve allows. It
demonstrates actions in physical units (``docs/reference/control.md``) and works with any of their
four combinations; the heuristic driver is faster.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.wrappers.control import ControlWrapper
from stkzoo.wrappers.racing import surroundings_of

__all__ = [
    "PursuitDriver",
    "PursuitParameters",
    "PursuitState",
    "create_state",
    "env_name",
    "get_actor",
    "get_wrappers",
    "player_name",
]
__dir__ = __all__.copy

#: Id of the environment that the driver was made for; its wrapper adds physical units.
env_name = "supertuxkart/full-v0"

#: Display name.
player_name = "pursuit"

FloatArray = npt.NDArray[np.float64]

#: Spacing of the points at which the curve ahead is measured [m].
_APART = 4.0
_MAX_SPEED = 100.0  # [m/s]; no kart is as fast


@dataclass(frozen=True, slots=True)
class PursuitParameters:
    """Parameters of the driver.

    Attributes:
        aim_distance: distance of the target point at rest [m].
        aim_time: additional distance per speed [s].
        top_speed: speed on a straight [m/s].
        least_speed: speed in the sharpest curve [m/s].
        side_accl: lateral acceleration in a curve [m/s^2].
        wheel_base: wheel base of the kart [m].
        gain: factor on the steering angle of the arc.
        stuck_steps: steps without motion after which it calls the rescue.
    """

    aim_distance: float = 5.0
    aim_time: float = 0.5
    top_speed: float = 20.0
    least_speed: float = 7.0
    side_accl: float = 24.0
    wheel_base: float = 1.008
    gain: float = 1.4
    stuck_steps: int = 25


@dataclass(slots=True)
class PursuitState:
    """State of the driver in one race.

    Attributes:
        still_steps: steps for which the kart has stood still.
    """

    still_steps: int = 0


@dataclass(frozen=True, slots=True)
class PursuitDriver:
    """Drives a kart from observations in the ``full`` view, with speed and steering angle.

    Args:
        parameters: parameters of the driver.
    """

    parameters: PursuitParameters = field(default_factory=PursuitParameters)

    def __call__(self, state: PursuitState, observation: Mapping[str, Any]) -> dict[str, Any]:
        """Returns an action with ``control`` and ``rescue``; observations are in ``full``."""
        speed = float(observation["velocity"][2])
        is_still = abs(speed) < 0.5 and observation["phase"] >= 2
        state.still_steps = state.still_steps + 1 if is_still else 0
        rescue = state.still_steps > self.parameters.stuck_steps
        if rescue:
            state.still_steps = 0
        target = self.aim(observation)
        control = np.array([np.clip(target[0], -0.425, 0.425), target[1]], np.float32)
        return {"control": control, "rescue": int(rescue)}

    def aim(self, observation: Mapping[str, Any]) -> tuple[float, float]:
        """Returns the steering angle [rad], positive to the right, and the target speed [m/s]."""
        rules = self.parameters
        # An observation from a network can have any speed, and the curve's size depends on it.
        speed = min(max(float(observation["velocity"][2]), 0.0), _MAX_SPEED)
        aim = rules.aim_distance + rules.aim_time * speed
        curve = np.arange(0.0, 12.0 + 1.2 * speed, _APART)
        around = surroundings_of(observation, np.array([aim, *curve], np.float32))
        points = around.road[0, :, :3].astype(np.float64)
        x, _, z = points[0].tolist()
        distance = max(math.hypot(x, z), 1.0)
        angle = math.atan2(x, z)
        arc = 2.0 * math.sin(angle) / distance
        if abs(angle) > math.pi / 2:
            arc = math.copysign(1.0, angle)
        return rules.gain * math.atan(rules.wheel_base * arc), self._speed(points[1:])

    def _speed(self, points: FloatArray) -> float:
        """Returns the lowest speed that the curve through some points allows [m/s]."""
        rules = self.parameters
        steps = np.diff(points, axis=0)
        turns = np.abs(np.diff(np.unwrap(np.arctan2(steps[:, 0], steps[:, 2]))))
        if not len(turns):
            return rules.top_speed
        sharpest = max(float(turns.max()) / _APART, 1e-6)
        return float(
            np.clip(math.sqrt(rules.side_accl / sharpest), rules.least_speed, rules.top_speed)
        )


create_state = PursuitState


def get_wrappers() -> list[Any]:
    """Returns wrappers for actions of speed, steering angle and the rescue button."""
    return [partial(ControlWrapper, buttons=("rescue",))]


def get_actor(module_dir: object, observation_space: Any, action_space: Any) -> PursuitDriver:
    """Returns the driver; it ignores the arguments.

    Args:
        module_dir: folder of the driver's module.
        observation_space: observation space of the agent.
        action_space: action space of the agent.
    """
    del module_dir, observation_space, action_space
    return PursuitDriver()
