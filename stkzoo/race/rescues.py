"""Counts rescues of karts, which put them back on the road.

The engine does not report rescues, but their signature is clear. The kart's body leaves the physics
world: its speed is exactly 0 and its velocity is not updated. Meanwhile, the kart descends at a
constant rate. An explosion also lifts a kart, but then the kart accelerates as it falls.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

#: Bounds of the descent rate [m/s]; PySuperTuxKart2 0.7.4 uses 1.67.
_SLOWEST, _FASTEST = 0.5, 5.0
#: Maximum acceleration of an even descent [m/s²]; explosions fall at about 10.
_EVEN = 0.5
#: Maximum difference between two equal movements on a track of 1 km, from float32 positions [m].
_ROUNDING = 1.2e-4


class RescueCounter:
    """Counts the rescues of each kart in one race.

    Args:
        num_kart: number of karts.
        step_size: game time between two updates [s]. The counts are reliable for multiples of the
            engine's physics step of 1/120 s up to about 0.25 s.

    Attributes:
        counts: ``(num_kart,)`` int, number of rescues so far, in grid order.
    """

    def __init__(self, num_kart: int, step_size: float) -> None:
        self.counts = np.zeros(num_kart, np.intp)
        self._shortest, self._longest = _SLOWEST * step_size, _FASTEST * step_size
        self._same = max(_EVEN * step_size**2, _ROUNDING)
        self._before: npt.NDArray[np.void] | None = None
        self._movement = np.zeros((num_kart, 3))
        self._is_descending = np.zeros(num_kart, bool)

    def update(self, karts: npt.NDArray[np.void]) -> None:
        """Counts the rescues that begin in this step.

        Args:
            karts: ``(num_kart,)`` records of :data:`~stkzoo.engine.snapshot.KART_DTYPE`.
        """
        before, self._before = self._before, karts
        if before is None or karts["speed"].all():
            self._is_descending[:], self._movement[:] = False, 0.0
            return
        is_out = (karts["speed"] == 0) & (karts["velocity"] == before["velocity"]).all(axis=1)
        movement = karts["location"].astype(float) - before["location"]
        length = np.linalg.norm(movement, axis=1)
        is_even = (np.abs(movement - self._movement) < self._same).all(axis=1)
        is_slow = (length > self._shortest) & (length < self._longest)
        is_descending = is_out & is_even & is_slow & (movement[:, 1] < 0)
        self.counts += is_descending & ~self._is_descending
        self._is_descending, self._movement = is_descending, movement
