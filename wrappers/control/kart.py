"""Limits and throttle and brake models of karts, as measured in the engine."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._checks import check_arguments, check_name, check_number, check_type
from stkzoo.errors import ConfigError

FloatArray = npt.NDArray[np.floating[Any]]
BoolArray = npt.NDArray[np.bool_]

#: Wheel base [m] and steering angle at rest [rad] of each kart model
#: (``benchmarks/results/control.json``).
KARTS = {
    "adiumy": (0.662, 0.279),
    "amanda": (1.036, 0.389),
    "emule": (0.804, 0.339),
    "gavroche": (0.893, 0.376),
    "gnu": (0.944, 0.398),
    "kiki": (0.861, 0.413),
    "konqi": (1.114, 0.469),
    "nolok": (0.992, 0.418),
    "pidgin": (0.872, 0.327),
    "puffy": (1.104, 0.414),
    "sara_the_racer": (0.808, 0.388),
    "sara_the_wizard": (0.856, 0.361),
    "suzanne": (0.986, 0.415),
    "tux": (1.008, 0.425),
    "wilber": (1.204, 0.577),
    "xue": (1.015, 0.427),
}


# Source of the values below: benchmarks/results/control.json (tux, difficulty 2, flat straight).

#: Lowest speed of each gear above the first [m/s], and acceleration of full throttle [m/s^2].
_GEARS = (2.3, 5.75, 10.35, 16.1)
_THRUST = np.array((14.1, 12.0, 10.05, 8.15, 7.05))

#: Deceleration of the brake in each gear, without drag [m/s^2]; at standstill it reverses.
_BRAKE = np.array((23.0, 23.0, 19.7, 16.3, 14.0))
_REVERSE = 28.0
_REVERSE_SPEED = 0.5

#: Drag with the throttle closed: _ROLL_DRAG + _AIR_DRAG * speed^2.
_ROLL_DRAG = 0.55  # [m/s^2]
_AIR_DRAG = 0.0072  # [1/m]

#: Below this speed [m/s] the game stops a kart with a closed throttle within a step.
_SELF_STOP_SPEED = 5.0
#: Below this speed [m/s], closing the throttle is the most precise way to stop.
_STOP_SPEED = 3.5
#: Smallest throttle that keeps a slow kart rolling.
_ROLLING = 0.005


#: Largest time constant of the wheels [s].
_MAX_LAG = 10.0

#: The same values in the form of the kernel.
PEDALS = np.array(
    [
        *(*_GEARS, *_THRUST, *_BRAKE, _REVERSE, _REVERSE_SPEED),
        *(_ROLL_DRAG, _AIR_DRAG, _SELF_STOP_SPEED, _STOP_SPEED, _ROLLING),
    ]
)


@check_arguments
@dataclass(frozen=True, slots=True, kw_only=True)
class CarParameters:
    """Limits of the actions, and parameters of the controllers' model.

    The defaults are those of the game's default kart, tux, at difficulty 2. The observed
    ``max_steer_angle`` limits the steering further at higher speeds.

    Attributes:
        v_min: lowest speed of actions, negative for reverse [m/s].
        v_max: highest speed of actions [m/s]: 25 is the game's limit at difficulty 3; at 2, 1 and
            0, karts reach 23, 20 and 15.
        a_max: largest acceleration and deceleration of actions [m/s^2], given by the brake. Full
            throttle accelerates by 14 at rest and by 3.6 at 20 m/s.
        s_max: largest steering angle, at rest [rad].
        sv_max: fastest turn of the wheels [rad/s]; from lock to lock as fast as keyboard steering
            in the game.
        wheel_base: wheel base [m]; a steering angle ``s`` follows a circle of radius ``wheel_base /
            tan(s)``.
        speed_gain: gain of the speed controller: acceleration per speed error [1/s].
        T_steer: time constant of the wheels [s]. They follow a ``steering_angle`` with a
            first-order lag and cover 63% of the way in this time. With 0, only ``sv_max`` limits
            them.
    """

    v_min: float = -5.0
    v_max: float = 25.0
    a_max: float = 17.5
    s_max: float = 0.425
    sv_max: float = 1.9
    wheel_base: float = 1.008
    speed_gain: float = 8.0
    T_steer: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            low = -math.inf if field.name == "v_min" else 0.0
            high = _MAX_LAG if field.name == "T_steer" else None
            check_number(field.name, getattr(self, field.name), low, high)
        if self.v_min >= self.v_max:
            raise ConfigError(f"v_min is {self.v_min!r}, expected less than v_max={self.v_max!r}")
        if self.s_max >= math.pi / 2:
            raise ConfigError(f"s_max is {self.s_max!r}, expected radians below pi / 2")

    @classmethod
    def of(cls, value: CarParameters | Mapping[str, float] | None, kart: str = "") -> CarParameters:
        """Converts a mapping of some fields to parameters; ``None`` selects the defaults.

        Args:
            value: the parameters. A mapping may also have ``s_min`` and ``sv_min``, as in F1TENTH
                gymkhana, which must be ``-s_max`` and ``-sv_max``.
            kart: kart model that provides the other fields, such as ``"gnu"``; empty for the game's
                default.

        Raises:
            ConfigError: the value has another type, a field is unknown or invalid, or there are no
                measurements of the kart.
        """
        if isinstance(value, CarParameters):
            return value
        expected = "CarParameters or a mapping of its fields"
        check_type("params", value, Mapping | None, expected)
        kart = kart or "tux"
        check_name("kart", kart, KARTS)
        wheel_base, s_max = KARTS[kart]
        values = {"wheel_base": wheel_base, "s_max": s_max, **(value or {})}
        lowest = {name: values.pop(name) for name in ("s_min", "sv_min") if name in values}
        parameters = cls(**values)
        for name, low in lowest.items():
            highest = name.replace("min", "max")
            if low != -getattr(parameters, highest):
                raise ConfigError(f"{name} is {low!r}, expected -{highest}: karts are symmetric")
        return parameters

    def steering_angle(self, radius: float) -> float:
        """Returns the steering angle [rad] for a circle of a radius [m], positive to the right."""
        return math.atan(self.wheel_base / radius)


def acceleration_of(
    throttle: FloatArray, brake: BoolArray, speed: FloatArray, step_size: float
) -> FloatArray:
    """Returns the acceleration [m/s^2] due to throttle and brake, ``(...)``.

    Args:
        throttle: ``(...)`` in [0, 1].
        brake: ``(...)`` bool.
        speed: ``(...)`` forward speed [m/s].
        step_size: duration of a step [s].
    """
    stops = (throttle <= 0) & ~brake & (np.abs(speed) < _SELF_STOP_SPEED)
    gear = np.searchsorted(_GEARS, speed)
    drag = np.sign(speed) * (_ROLL_DRAG + _AIR_DRAG * speed * speed)
    driven = throttle * _THRUST[gear] - drag
    braked = -np.where(speed > _REVERSE_SPEED, _BRAKE[gear], _REVERSE) - drag
    stopped = -np.sign(speed) * np.minimum(np.abs(speed) / step_size, 30.0)
    return np.where(brake, braked, np.where(stops, stopped, driven))
