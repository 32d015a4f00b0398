"""Counts rescues of karts, which put them back on the road.

The engine does not report rescues, but their signature is clear. The kart's body leaves the physics
world: its speed is exactly 0 and its velocity is not updated. Meanwhile, the kart descends at a
constant rate. An explosion also lifts a kart, but then the kart accelerates as it falls.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stkzoo.engine.starting import TICK

#: Bounds of the descent rate [m/s]; PySuperTuxKart2 0.7.4 uses 1.67.
_SLOWEST, _FASTEST = 0.5, 5.0
#: Maximum acceleration of an even descent [m/s²]; explosions fall at about 10.
_EVEN = 0.5
#: Maximum difference between two equal movements on a track of 1 km, from float32 positions [m].
_ROUNDING = 1.2e-4


class RescueCounter:
    """Counts the rescues of each kart in one race.

    The counts are reliable if the time between two updates is at most about 0.25 s. The engine
    runs whole ticks, so unless that time is a multiple of a tick, the number of ticks varies. The
    race clock shows how many there were.

    Args:
        num_kart: number of karts.

    Attributes:
        counts: ``(num_kart,)`` int, number of rescues so far, in grid order.
    """

    def __init__(self, num_kart: int) -> None:
        self.counts = np.zeros(num_kart, np.intp)
        self._before: npt.NDArray[np.void] | None = None
        self._time = 0.0
        self._rate = np.zeros((num_kart, 3))  # of the latest movements [m/s]
        self._is_descending = np.zeros(num_kart, bool)

    def update(self, karts: npt.NDArray[np.void], time: float) -> None:
        """Counts the rescues that begin in this step.

        Args:
            karts: ``(num_kart,)`` records of :data:`~stkzoo.engine.snapshot.KART_DTYPE`.
            time: race clock at the same moment [s].
        """
        before, self._before = self._before, karts
        ticks = round((time - self._time) / TICK)
        if before is not None and ticks == 0:
            return  # a step shorter than a tick, or before GO
        self._time = time
        if before is None or karts["speed"].all():
            self._is_descending[:], self._rate[:] = False, 0.0
            return
        seconds = ticks * TICK
        is_out = (karts["speed"] == 0) & (karts["velocity"] == before["velocity"]).all(axis=1)
        rate = (karts["location"].astype(float) - before["location"]) / seconds
        speed = np.linalg.norm(rate, axis=1)
        same = max(_EVEN * seconds, _ROUNDING / seconds)
        is_even = (np.abs(rate - self._rate) < same).all(axis=1)
        is_slow = (speed > _SLOWEST) & (speed < _FASTEST)
        is_descending = is_out & is_even & is_slow & (rate[:, 1] < 0)
        self.counts += is_descending & ~self._is_descending
        self._is_descending, self._rate = is_descending, rate
