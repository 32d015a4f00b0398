"""What happens to karts in a race: contacts, hits, items, overtakes, rescues, time lost.

The engine reports ranks, and what karts carry. The kernel's ``EventCounter`` reads the rest from
where karts are and how they move before and after a step. ``python -m benchmarks.events`` compares
it with races that are recorded at 120 Hz; its thresholds are for steps of about 0.1 s.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.engine.track import TrackMap
from stkzoo.kernel import EventCounter

#: The events of a step, in the order of :attr:`RaceEvents.counts`. Numbers, but for the last two,
#: which are seconds.
EVENTS = (
    "kart_contact",  # its box and another kart's begin to touch, 0.5 s after they last did
    "wall_contact",  # driving forwards, it hits what is no kart and loses 5 m/s at once
    "hit",  # it is thrown over, meets bubble gum, or gets a parachute, an anvil or a bomb
    "item_taken",  # a powerup or nitro
    "item_used",  # a powerup is fired
    "overtake",  # a kart that was ahead in the ranking is behind it now
    "overtaken",  # the reverse
    "rescue",  # it is lifted and put back on the road
    "off_road",  # [s] beside the driving line's segments
    "wrong_way",  # [s] faster than 1 m/s against the road's direction
)
#: What :attr:`RaceEvents.seconds` counts, in order.
STREAKS = ("off_road", "wrong_way", "stuck")
#: Of the kernel's memory, beside a column for each kart.
_NUM_OWN = 8
_PLACE = slice(3, 6)


class RaceEvents:
    """The events of all K karts of a race. Copies count on their own.

    Args:
        track: the race's track.
        step_size: game time of a step [s].
        num_kart: number of karts, K.

    Attributes:
        counts: ``(K, E)`` float64: the latest step's :data:`EVENTS`.
    """

    def __init__(self, track: TrackMap, step_size: float, num_kart: int) -> None:
        self.counts = np.zeros((num_kart, len(EVENTS)))
        self._track, self._step_size = track, step_size
        self._memory = np.zeros((num_kart, _NUM_OWN + num_kart))
        self._memory[:, _PLACE] = np.inf  # not known yet
        self._counter = EventCounter(track.path_nodes, step_size, self._memory, self.counts)

    @property
    def seconds(self) -> npt.NDArray[np.float64]:
        """``(K, 3)``: for how long each kart has been in each of :data:`STREAKS` [s].

        A kart is stuck while it stays within 3 m.
        """
        return self._memory[:, : len(STREAKS)]

    def count(self, before: Snapshot, after: Snapshot) -> None:
        """Counts what happened in the step between two moments; before GO, nothing does."""
        self._counter.count(before.data, after.data)

    def __deepcopy__(self, memo: dict[int, Any]) -> RaceEvents:
        twin = RaceEvents(self._track, self._step_size, len(self.counts))
        twin.counts[:], twin._memory[:] = self.counts, self._memory
        return twin
