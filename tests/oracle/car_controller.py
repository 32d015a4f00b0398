"""The NumPy implementation of ``car_controller.c``."""

from __future__ import annotations

import math

import numpy as np

from stkzoo.engine.snapshot import Snapshot

#: Columns of the controls.
_THROTTLE, _STEER, _BRAKE = range(3)


class CarController:
    def __init__(self, kinds, limits, pedals):
        self._is_speed, self._is_angle, self._is_normalized = kinds
        self._ranges = (limits[0], limits[1]), (limits[2], limits[3])
        self._v_min, self._v_max, self._sv_max, self._gain, self._lag = limits[4:]
        self._gears, self._thrusts, self._brakes, rest = np.split(pedals, [4, 9, 14])
        self._reverse, self._reverse_speed, self._roll_drag, self._air_drag, *rest = rest
        self._self_stop_speed, self._stop_speed, self._rolling = rest

    def drive(self, controls, rows, data, karts, states, places):
        kart = Snapshot(data).karts[karts]
        speed = kart["velocity_lc"][:, 2].astype(np.float64)
        most = np.maximum(kart["max_steer_angle"].astype(np.float64), 1e-3)
        angle, owed, step = states[places].T
        turn = self._physical(controls[rows, _STEER], *self._ranges[0])
        asked = self._physical(controls[rows, _THROTTLE], *self._ranges[1])
        angle = self._steer(turn, angle, most, step)
        if self._is_speed:
            accl = (asked - speed) * np.minimum(self._gain, 0.8 / step)
            throttle, brake = self._press(accl, speed, step)
            owed = np.zeros_like(owed)
        else:
            slowest, fastest = (self._v_min - speed) / step, (self._v_max - speed) / step
            accl = np.clip(asked, np.minimum(slowest, 0.0), np.maximum(fastest, 0.0))
            pull = self._drag(speed)
            accl = np.clip(accl, -self._brake(speed) - pull, self._thrust(speed) - pull)
            accl = accl + owed / step
            throttle, brake = self._press(accl, speed, step)
            owed = np.clip((accl - self._effect(throttle, brake, speed, step)) * step, -2.0, 2.0)
        states[places, 0], states[places, 1] = angle, owed
        controls[rows, _THROTTLE] = throttle
        controls[rows, _STEER] = angle / most
        controls[rows, _BRAKE] = brake

    def _physical(self, values, low, high):
        values = values.astype(np.float64)
        return low + (values + 1.0) / 2.0 * (high - low) if self._is_normalized else values

    def _steer(self, asked, angle, most, step):
        share = np.array(
            [1.0 - math.exp(-each / self._lag) if self._lag > 0 else 1.0 for each in step]
        )
        rate = (asked - angle) / step * share if self._is_angle else asked
        return np.clip(angle + np.clip(rate, -self._sv_max, self._sv_max) * step, -most, most)

    def _press(self, accl, speed, step):
        force = accl + self._drag(speed)
        throttle = np.clip(force / self._thrust(speed), 0.0, 1.0)
        following = np.abs(speed + accl * step)
        stops = (np.abs(speed) < self._stop_speed) & (following < 0.5)
        stops &= following <= 0.55 * np.abs(speed) + 0.02
        brake = (force < -self._brake(speed) / 2) & ~stops
        rolls = (np.abs(speed) < self._self_stop_speed + 0.5) & ~stops
        throttle = np.where(rolls, np.maximum(throttle, self._rolling), throttle)
        return np.where(stops | brake, 0.0, throttle), brake

    def _effect(self, throttle, brake, speed, step):
        stops = (throttle <= 0) & ~brake & (np.abs(speed) < self._self_stop_speed)
        driven = throttle * self._thrust(speed) - self._drag(speed)
        braked = -self._brake(speed) - self._drag(speed)
        stopped = -np.sign(speed) * np.minimum(np.abs(speed) / step, 30.0)
        return np.where(brake, braked, np.where(stops, stopped, driven))

    def _thrust(self, speed):
        return self._thrusts[np.searchsorted(self._gears, speed)]

    def _brake(self, speed):
        brake = self._brakes[np.searchsorted(self._gears, speed)]
        return np.where(speed > self._reverse_speed, brake, self._reverse)

    def _drag(self, speed):
        return np.sign(speed) * (self._roll_drag + self._air_drag * speed * speed)
