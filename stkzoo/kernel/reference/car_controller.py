"""The twin of ``car_controller.c``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot

IntArray = npt.NDArray[np.intp]


class CarController:
    """Speed or acceleration and a steering angle or its speed, as the game's controls.

    Args:
        act: :meth:`stkzoo.wrappers.control.CarAction.act`, which does the twin's work.
        kinds: whether a speed is asked for, whether an angle, and whether from -1 to 1; the
            extension's formulas need it, as all that follows but ``columns``.
        limits: of steering and of the longitudinal number, then those of the kart.
        pedals: the model of the kart.
        columns: of throttle, steering and brake.
        num_columns: of the controls.
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
        """Replaces what is asked for by what the game is told.

        Args:
            controls: ``(P, n)`` with the longitudinal number in the throttle's column.
            rows: ``(A,)`` the rows to change.
            data: the bytes of the present snapshot.
            karts: ``(A,)`` whose rows they are.
            states: ``(S, 3)`` what the controllers remember, which changes, and the length of
                their steps [s].
            places: ``(A,)`` rows of the states.
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
