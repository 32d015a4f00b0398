"""Counts how often karts are put back on the road.

The engine does not say that a kart is being rescued, but nothing else looks like it: the kart's
body is out of the world (its speed is exactly 0 and its velocity is not computed any more)
while the kart is let down at a constant rate. The other thing that lifts a kart, an explosion,
throws it up and lets it fall ever faster.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["RescueCounter"]

#: Between these a kart is let down [m/s]; PySuperTuxKart2 0.7.4 does it at 1.67.
_SLOWEST, _FASTEST = 0.5, 5.0
#: Two steps with the same way, up to rounding [m].
_SAME = 5e-3


class RescueCounter:
    """Counts the rescues of every kart in one race.

    Args:
        num_kart: number of karts.
        step_size: game time between two looks [s]; with more than about 0.25 s a rescue
            may be missed.

    Attributes:
        counts: ``(num_kart,)`` rescues so far, in grid order.
    """

    def __init__(self, num_kart: int, step_size: float) -> None:
        self.counts = np.zeros(num_kart, np.intp)
        self._shortest, self._longest = _SLOWEST * step_size, _FASTEST * step_size
        self._before: npt.NDArray[np.void] | None = None
        self._way = np.zeros((num_kart, 3))
        self._is_let_down = np.zeros(num_kart, bool)

    def look(self, karts: npt.NDArray[np.void]) -> None:
        """Looks at the karts after a step.

        Args:
            karts: ``(num_kart,)`` records of :data:`~stkzoo.engine.snapshot.KART_DTYPE`.
        """
        before, self._before = self._before, karts
        if before is None or karts["speed"].all():
            self._is_let_down[:], self._way[:] = False, 0.0
            return
        is_out = (karts["speed"] == 0) & (karts["velocity"] == before["velocity"]).all(axis=1)
        way = karts["location"].astype(float) - before["location"]
        length = np.linalg.norm(way, axis=1)
        is_even = (np.abs(way - self._way) < _SAME).all(axis=1)
        is_slow = (length > self._shortest) & (length < self._longest)
        is_let_down = is_out & is_even & is_slow & (way[:, 1] < 0)
        self.counts += is_let_down & ~self._is_let_down
        self._is_let_down, self._way = is_let_down, way
