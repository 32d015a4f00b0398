"""Pure pursuit: the arc through the kart and a point of the road ahead."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["PursuitDriver", "PursuitParameters", "PursuitState", "control_of"]

FloatArray = npt.NDArray[np.float64]

#: Segments of the road that are looked at.
_MAX_SEGMENTS = 60

#: Segments that follow one another begin where the last one ended, within this [m].
_LONGEST_JUMP = 20.0


@dataclass(frozen=True, slots=True)
class PursuitParameters:
    """The numbers that the driver goes by.

    Attributes:
        aim_distance: how far ahead it aims at rest [m].
        aim_time: how much farther for each m/s [s].
        top_speed: how fast it goes on a straight [m/s].
        least_speed: how fast it goes in the sharpest curve [m/s].
        side_accl: how hard it takes a curve [m/s^2].
        wheel_base: the kart's [m].
        gain: steering beyond the arc's own angle.
        stuck_steps: steps without moving after which it calls for rescue.
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
    """What the driver remembers in one race.

    Attributes:
        still_steps: how long the kart has stood still.
    """

    still_steps: int = 0


@dataclass(frozen=True, slots=True)
class PursuitDriver:
    """Drives a kart that sees the ``full`` view by speed and steering angle.

    Args:
        parameters: the numbers that it goes by.
    """

    parameters: PursuitParameters = field(default_factory=PursuitParameters)

    def __call__(self, state: PursuitState, observation: Mapping[str, Any]) -> dict[str, Any]:
        """An action of the ``full`` observation with ``control`` and ``rescue``."""
        speed = float(observation["velocity"][2])
        is_still = abs(speed) < 0.5 and observation["phase"] >= 2
        state.still_steps = state.still_steps + 1 if is_still else 0
        rescue = state.still_steps > self.parameters.stuck_steps
        if rescue:
            state.still_steps = 0
        target = self.aim(observation)
        low, high = -0.425, 0.425
        control = np.array([np.clip(target[0], low, high), target[1]], np.float32)
        return {"control": control, "rescue": int(rescue)}

    def aim(self, observation: Mapping[str, Any]) -> tuple[float, float]:
        """The steering angle [rad], positive to the right, and the speed [m/s] to drive with."""
        rules = self.parameters
        speed = max(float(observation["velocity"][2]), 0.0)
        points, marks = _road_ahead(observation)
        ahead = np.array([rules.aim_distance + rules.aim_time * speed])
        x, _, z = _at(points, marks, ahead)[0]
        distance = max(math.hypot(x, z), 1.0)
        angle = math.atan2(x, z)
        arc = 2.0 * math.sin(angle) / distance
        if abs(angle) > math.pi / 2:
            arc = math.copysign(1.0, angle)
        return rules.gain * math.atan(rules.wheel_base * arc), self._speed(points, marks, speed)

    def _speed(self, points: FloatArray, marks: FloatArray, speed: float) -> float:
        """The lowest speed that a curve within reach allows."""
        rules = self.parameters
        ahead = np.arange(0.0, 12.0 + 1.2 * speed, 4.0)
        steps = np.diff(_at(points, marks, ahead), axis=0)
        turns = np.abs(np.diff(np.unwrap(np.arctan2(steps[:, 0], steps[:, 2]))))
        if not len(turns):
            return rules.top_speed
        sharpest = max(float(turns.max()) / 4.0, 1e-6)
        return float(
            np.clip(math.sqrt(rules.side_accl / sharpest), rules.least_speed, rules.top_speed)
        )


def control_of(
    kinds: tuple[str, str],
    aim: tuple[float, float],
    angle: float,
    speed: float,
    step_size: float = 0.1,
) -> npt.NDArray[np.float32]:
    """The same drive through another pair of actions: what a cascade around them would ask for.

    Args:
        kinds: ``("speed" or "accl", "steering_angle" or "steering_speed")``.
        aim: steering angle [rad] and speed [m/s], from :meth:`PursuitDriver.aim`.
        angle: the present angle of the wheels [rad].
        speed: the present speed [m/s].
        step_size: how long a step lasts [s].

    Returns:
        ``(2,)`` float32, steering first.
    """
    longitudinal, steering = kinds
    first = aim[0] if steering == "steering_angle" else (aim[0] - angle) / step_size
    second = aim[1] if longitudinal == "speed" else 3.0 * (aim[1] - speed)
    return np.array([first, second], np.float32)


def _road_ahead(observation: Mapping[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Points of the centre line in the kart frame and their distance along it, from the kart on."""
    starts = np.array(observation["paths_start"][:_MAX_SEGMENTS], np.float64)
    ends = np.array(observation["paths_end"][:_MAX_SEGMENTS], np.float64)
    chain = [0]
    for number in range(1, len(starts)):  # of a fork, the branch that goes on where this one ends
        gap = np.linalg.norm(starts[number] - ends[chain[-1]])
        if gap < (0.3 if _follows(starts, ends, chain[-1], number) else _LONGEST_JUMP):
            chain.append(number)
    points = np.stack([starts[chain], ends[chain]], axis=1).reshape(-1, 3)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    marks = np.concatenate([[0.0], np.cumsum(steps)])
    along = points[1] - points[0]
    passed = np.clip(-points[0] @ along / max(along @ along, 1e-9), 0.0, 1.0)
    return points, marks - passed * steps[0]


def _follows(starts: FloatArray, ends: FloatArray, last: int, number: int) -> bool:
    """Whether a segment other than ``number`` begins where ``last`` ends."""
    gaps = np.linalg.norm(starts[number:] - ends[last], axis=1)
    return bool((gaps < 0.3).any())


def _at(points: FloatArray, marks: FloatArray, wanted: FloatArray) -> FloatArray:
    return np.stack([np.interp(wanted, marks, column) for column in points.T], axis=1)
