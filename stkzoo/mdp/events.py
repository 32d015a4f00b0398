"""Events of karts in a race: contacts, hits, items, overtakes, rescues, and time off the road.

The engine reports ranks and what karts carry. The kernel's ``EventCounter`` derives the other
events from the karts' positions and velocities before and after a step. Its thresholds are meant
for steps of about 0.1 s; ``docs/reference/events.md`` compares it with races recorded at 120 Hz.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stkzoo.engine.snapshot import Snapshot
from stkzoo.engine.track import TrackMap
from stkzoo.kernel import EventCounter

#: The events of a step, in the order of :attr:`RaceEvents.counts`. The last two are durations [s],
#: the others are counts.
EVENTS = (
    "kart_contact",  # its box touches another kart's, at least 0.5 s after their last contact
    "wall_contact",  # while driving forwards, it loses 5 m/s at once, but not to a kart
    "hit",  # an item flips it, it touches bubble gum, or it gets a parachute, an anvil or a bomb
    "item_taken",  # it collects a powerup or nitro
    "item_used",  # it fires a powerup
    "overtake",  # a kart that ranked ahead of it now ranks behind
    "overtaken",  # a kart that ranked behind it now ranks ahead
    "rescue",  # it is lifted and placed back on the road
    "off_road",  # [s] outside the driving line's segments
    "wrong_way",  # [s] faster than 1 m/s against the direction of the road
)
#: The columns of :attr:`RaceEvents.seconds`.
STREAKS = ("off_road", "wrong_way", "stuck")
#: Number of columns in the kernel's memory, in addition to one column per kart.
_NUM_OWN = 8
_PLACE = slice(3, 6)


class RaceEvents:
    """Counts the events of all K karts of a race. A deep copy counts independently.

    Args:
        track: map of the track.
        step_size: game time of a step [s].
        num_kart: number of karts, K.

    Attributes:
        counts: ``(K, E)`` float64, the :data:`EVENTS` of the latest step.
        seconds: ``(K, 3)`` float64, how long each kart has been in each state of :data:`STREAKS`
            [s]. A kart counts as stuck while it stays within 3 m.
    """

    def __init__(self, track: TrackMap, step_size: float, num_kart: int) -> None:
        self.counts = np.zeros((num_kart, len(EVENTS)))
        self._track, self._step_size = track, step_size
        self._memory = np.zeros((num_kart, _NUM_OWN + num_kart))
        self._memory[:, _PLACE] = np.inf  # unknown before the first step
        self.seconds = self._memory[:, : len(STREAKS)]
        self._counter = EventCounter(track.path_nodes, step_size, self._memory, self.counts)

    def count(self, before: Snapshot, after: Snapshot) -> None:
        """Counts the events of the step between two snapshots; none occur before the GO phase."""
        self._counter.count(before.data, after.data)

    def __deepcopy__(self, memo: dict[int, Any]) -> RaceEvents:
        twin = RaceEvents(self._track, self._step_size, len(self.counts))
        twin.counts[:], twin._memory[:] = self.counts, self._memory
        return twin
