"""Throttle and brake for an acceleration, from a measured model of the kart."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.floating[Any]]
BoolArray = npt.NDArray[np.bool_]

# All from benchmarks/results/control.json: tux, difficulty 2, a flat straight.

#: What full throttle adds [m/s^2], in each gear from a speed [m/s] on.
_GEARS = (2.3, 5.75, 10.35, 16.1)
_THRUST = np.array((14.1, 12.0, 10.05, 8.15, 7.05))

#: What the brake takes beside the drag [m/s^2], in each gear; standing, it reverses.
_BRAKE = np.array((23.0, 23.0, 19.7, 16.3, 14.0))
_REVERSE = 28.0
_REVERSE_SPEED = 0.5

#: Rolling with the throttle shut: this, and the other times the speed squared.
_ROLL_DRAG = 0.55  # [m/s^2]
_AIR_DRAG = 0.0072  # [1/m]

#: Below this speed [m/s] the game stops a kart whose throttle is shut, within a step ...
_SELF_STOP_SPEED = 5.0
#: ... which is the finest way to stop below this one.
_STOP_SPEED = 3.5
#: This little throttle keeps it from doing so.
_ROLLING = 0.005


#: The same numbers as the kernel takes them.
PEDALS = np.array(
    [
        *(*_GEARS, *_THRUST, *_BRAKE, _REVERSE, _REVERSE_SPEED),
        *(_ROLL_DRAG, _AIR_DRAG, _SELF_STOP_SPEED, _STOP_SPEED, _ROLLING),
    ]
)


class Pedals:
    """Chooses throttle and brake, and foretells what they do."""

    def press(
        self, accl: FloatArray, speed: FloatArray, step_size: float
    ) -> tuple[FloatArray, BoolArray]:
        """The throttle in [0, 1] and whether to brake, for an acceleration [m/s^2].

        The brake is a button: it is pressed for a whole step or not at all, whichever comes
        nearer to what is asked for.

        Args:
            accl: ``(...)`` the acceleration [m/s^2].
            speed: ``(...)`` forward speed [m/s].
            step_size: how long a step lasts [s].
        """
        force = accl + _drag(speed)
        throttle = np.clip(force / _thrust(speed), 0.0, 1.0)
        # Standing still is nearer to what is asked for than rolling on or driving back.
        stops = (np.abs(speed) < _STOP_SPEED) & (np.abs(speed + accl * step_size) < 0.5)
        stops &= np.abs(speed + accl * step_size) <= 0.55 * np.abs(speed) + 0.02
        brake = (force < -_brake(speed) / 2) & ~stops
        rolls = (np.abs(speed) < _SELF_STOP_SPEED + 0.5) & ~stops
        throttle = np.where(rolls, np.maximum(throttle, _ROLLING), throttle)
        return np.where(stops | brake, 0.0, throttle), brake

    def effect(
        self, throttle: FloatArray, brake: BoolArray, speed: FloatArray, step_size: float
    ) -> FloatArray:
        """The acceleration [m/s^2] that throttle and brake give, ``(...)`` each."""
        stops = (throttle <= 0) & ~brake & (np.abs(speed) < _SELF_STOP_SPEED)
        driven = throttle * _thrust(speed) - _drag(speed)
        braked = -_brake(speed) - _drag(speed)
        stopped = -np.sign(speed) * np.minimum(np.abs(speed) / step_size, 30.0)
        return np.where(brake, braked, np.where(stops, stopped, driven))

    def reach(self, accl: FloatArray, speed: FloatArray) -> FloatArray:
        """The acceleration nearest to ``accl`` that the kart can give."""
        least, most = -_brake(speed) - _drag(speed), _thrust(speed) - _drag(speed)
        return np.clip(accl, least, most)


def _thrust(speed: FloatArray) -> FloatArray:
    thrust: FloatArray = _THRUST[np.searchsorted(_GEARS, speed)]
    return thrust


def _brake(speed: FloatArray) -> FloatArray:
    brake = _BRAKE[np.searchsorted(_GEARS, speed)]
    return np.where(speed > _REVERSE_SPEED, brake, _REVERSE)


def _drag(speed: FloatArray) -> FloatArray:
    return np.sign(speed) * (_ROLL_DRAG + _AIR_DRAG * speed * speed)
