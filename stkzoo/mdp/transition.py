"""One step of a race, as input to rewards and episode ends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from stkzoo._checks import check_name
from stkzoo.engine.snapshot import Snapshot
from stkzoo.errors import ConfigError
from stkzoo.mdp.events import EVENTS

FloatArray = npt.NDArray[np.float64]


def progress_of(snapshot: Snapshot) -> FloatArray:
    """Returns the distance driven by each kart [m], ``(K,)`` float64.

    It is 0 until the kart crosses the start line; before that, the engine's distance is negative.
    """
    return np.maximum(snapshot.karts["overall_distance"].astype(np.float64), 0.0)


@dataclass(frozen=True)
class Transition:
    """One step, for all K karts in grid order.

    Attributes:
        before: snapshot before the step.
        after: snapshot after the step.
        race_length: number of laps times the lap length [m].
        event_counts: ``(K, E)`` float64, the :data:`~stkzoo.mdp.events.EVENTS` of the step;
            ``None`` in an environment without ``events=True``.
    """

    before: Snapshot
    after: Snapshot
    race_length: float
    event_counts: FloatArray | None = None

    @property
    def num_kart(self) -> int:
        """Number of karts, K."""
        return len(self.after.karts)

    @cached_property
    def distance_before(self) -> FloatArray:
        """``(K,)`` float64, distance driven before the step [m]."""
        return progress_of(self.before)

    @cached_property
    def distance(self) -> FloatArray:
        """``(K,)`` float64, distance driven after the step [m]."""
        return progress_of(self.after)

    def event(self, name: str) -> FloatArray:
        """Returns each kart's count (or duration [s]) of an event in this step, ``(K,)`` float64.

        Args:
            name: one of :data:`~stkzoo.mdp.events.EVENTS`.

        Raises:
            ConfigError: the event does not exist, or the environment does not count events.
        """
        check_name("event", name, EVENTS)
        if self.event_counts is None:
            raise ConfigError("events are not counted; make the environment with events=True")
        return np.array(self.event_counts[:, EVENTS.index(name)])

    @cached_property
    def finishes(self) -> npt.NDArray[np.bool_]:
        """``(K,)`` bool, whether each kart finished the race in this step."""
        after, before = self.after.karts, self.before.karts
        now: npt.NDArray[np.bool_] = after["has_finished_race"] > before["has_finished_race"]
        return now
