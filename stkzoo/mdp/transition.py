"""One step of a race as rewards and endings see it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.errors import ConfigError, unknown_name
from stkzoo.mdp.events import EVENTS

FloatArray = npt.NDArray[np.float64]


def progress_of(snapshot: Snapshot) -> FloatArray:
    """Distance driven by each kart, ``(K,)`` float64 [m], 0 until it crosses the start line.

    The engine counts from minus one lap there, hence the bound.
    """
    return np.maximum(snapshot.karts["overall_distance"].astype(np.float64), 0.0)


@dataclass(frozen=True)
class Transition:
    """One step, for all K karts in grid order.

    Attributes:
        before: the moment before the step.
        after: the moment after it.
        race_length: laps times the lap's length [m].
        event_counts: ``(K, E)`` the step's :data:`~stkzoo.mdp.events.EVENTS`; ``None`` in an
            environment without ``events=True``.
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
        """``(K,)`` driven before the step [m]."""
        return progress_of(self.before)

    @cached_property
    def distance(self) -> FloatArray:
        """``(K,)`` driven after the step [m]."""
        return progress_of(self.after)

    @property
    def position(self) -> npt.NDArray[np.int32]:
        """``(K,)`` ranks after the step; 1 is first."""
        ranks: npt.NDArray[np.int32] = self.after.karts["position"]
        return ranks

    def event(self, name: str) -> FloatArray:
        """``(K,)``: how often an event happened to each kart in the step, or for how long [s].

        Args:
            name: one of :data:`~stkzoo.mdp.events.EVENTS`.

        Raises:
            ConfigError: there is none of this name, or the environment counts none.
        """
        if name not in EVENTS:
            raise unknown_name("event", name, EVENTS)
        if self.event_counts is None:
            raise ConfigError("events are not counted; make the environment with events=True")
        return np.array(self.event_counts[:, EVENTS.index(name)])

    @cached_property
    def finishes(self) -> npt.NDArray[np.bool_]:
        """``(K,)`` whether the kart finished the race in this step."""
        after, before = self.after.karts, self.before.karts
        now: npt.NDArray[np.bool_] = after["has_finished_race"] > before["has_finished_race"]
        return now
