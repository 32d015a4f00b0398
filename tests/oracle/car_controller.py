"""The NumPy reference implementation of ``car_controller.c``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot

IntArray = npt.NDArray[np.intp]


class CarController:
    """Converts a speed or acceleration and a steering angle or steering speed to controls.

    Only the extension uses the arguments ``kinds``, ``limits``, ``pedals`` and ``num_columns``.

    Args:
        act: :meth:`stkzoo.wrappers.control.CarAction.act`, which computes the controls.
        kinds: whether the longitudinal number is a speed, whether the steering number is an angle,
            and whether both are scaled to [-1, 1].
        limits: limits of the steering number, of the longitudinal number, and of the kart.
        pedals: model of the kart.
        columns: columns of throttle, steering and brake.
        num_columns: number of columns of the controls.
    """

    def __init__(
        self,
        act: Callable[..., Any],
        kinds: tuple[bool, bool, bool],
        limits: tuple[float, ...],
        pedals: npt.NDArray[np.float64],
        columns: tuple[int, int, int],
        num_columns: int,
    ) -> None:
        del kinds, limits, pedals, num_columns
        self._act, self._columns = act, columns

    def drive(
        self,
        controls: npt.NDArray[np.float32],
        rows: IntArray,
        data: bytes,
        karts: IntArray,
        states: npt.NDArray[np.float64],
        places: IntArray,
    ) -> None:
        """Replaces actions by the controls that the game takes.

        Args:
            controls: ``(P, n)``; the columns of steering and throttle hold the action's steering
                and longitudinal numbers.
            rows: ``(A,)`` rows to change.
            data: bytes of the current snapshot.
            karts: ``(A,)`` kart of each row.
            states: ``(S, 3)`` two columns of the controllers' memory, which are updated, and the
                length of a step [s].
            places: ``(A,)`` row of each kart in ``states``.
        """
        records = Snapshot(data).karts
        throttle, steer, brake = self._columns
        for row, kart, place in zip(rows.tolist(), karts.tolist(), places.tolist(), strict=True):
            told, states[place, :2] = self._act(
                controls[row, [steer, throttle]],
                np.float64(records["velocity_lc"][kart, 2]),
                np.float64(records["max_steer_angle"][kart]),
                states[place, :2],
                states[place, 2].item(),
            )
            controls[row, [throttle, steer, brake]] = told
