"""Contacts of karts and other events in a recorded race, as the environment counts them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from stkzoo.mdp.events import EVENTS, RaceEvents
from stkzoo.race.listeners import RaceListener, RaceProgress

#: The counted events, in the order of :attr:`ConductCounter.sums`.
COUNTED = ("kart_contact", "off_road", "overtake")
_COLUMNS = [EVENTS.index(name) for name in COUNTED]


@dataclass(frozen=True, slots=True)
class Contact:
    """Touches of two karts, each soon after the one before.

    Attributes:
        step: step of the race in which they first touch, from 1.
        karts: numbers of the two agents.
        counts: number of contacts that the environment counts for each; 0 for a kart that had
            finished.
        apart_since: step of the race since which they had not touched.
    """

    step: int
    karts: tuple[int, int]
    counts: tuple[int, int]
    apart_since: int = 0


def merge_touches(touches: Sequence[Contact], steps: int) -> list[Contact]:
    """Merges touches of the same two karts.

    Args:
        touches: one for each pair that touches in a step, in the order of the steps.
        steps: maximum distance of touches of the same contact [steps].

    Returns:
        The contacts, in the order of their first steps.
    """
    contacts: list[Contact] = []
    latest: dict[tuple[int, int], tuple[int, int]] = {}  # the contact and the step of its end
    for touch in touches:
        index, end = latest.get(touch.karts, (-1, 0))
        if index >= 0 and touch.step - end <= steps:
            merged = contacts[index]
            one, other = (a + b for a, b in zip(merged.counts, touch.counts, strict=True))
            contacts[index] = replace(merged, counts=(one, other))
        else:
            index = len(contacts)
            contacts.append(replace(touch, apart_since=end))
        latest[touch.karts] = index, touch.step
    return contacts


class ConductCounter(RaceListener):
    """Counts the events of all agents while they race, and notes which of them touch.

    Attributes:
        sums: ``(A, 3)`` float64, the events :data:`COUNTED` of each agent.
        touches: one for each pair of agents that touch in a step.
    """

    def __init__(self) -> None:
        self.sums = np.zeros((0, len(COUNTED)))
        self.touches: list[Contact] = []

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self._events, self._before = new_events(race), race.snapshot
        self._karts = list(race.race_info.kart_indices)
        self.sums = np.zeros((len(self._karts), len(COUNTED)))

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        is_new = self._events.is_next_counted
        self._events.count(self._before, race.snapshot)
        self._before = race.snapshot
        is_racing = [agent in race.observations for agent in race.env.possible_agents]
        counts = self._events.counts[np.ix_(self._karts, _COLUMNS)]
        self.sums[is_racing] += counts[is_racing]
        contacts = self._events.contacts
        for pair in combinations(range(len(self._karts)), 2):
            one, other = (self._karts[number] for number in pair)
            if contacts[one, other] and any(is_racing[number] for number in pair):
                counted = [int(is_new[one, other] and is_racing[number]) for number in pair]
                self.touches.append(Contact(race.steps, pair, (counted[0], counted[1])))


def new_events(race: RaceProgress) -> RaceEvents:
    """Returns an event counter for a race that starts.

    Args:
        race: the race.
    """
    track = race.env.track_map
    assert track is not None  # noqa: S101 - the race has started
    return RaceEvents(track, race.env.options.step_size, race.env.options.num_kart)
