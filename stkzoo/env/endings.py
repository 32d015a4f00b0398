"""Optional ends of an agent's episode, in addition to its kart's finish."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.env.options import RaceOptions
from stkzoo.mdp.events import STREAKS

#: Rewards, terminations and truncations, each an array with one number per slot.
EndArrays = tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.bool_]]


class Endings:
    """Ends the episodes of agents that fail, and of all others after the first finish.

    An agent whose kart is stuck, drives in the wrong direction or is off the road for too long is
    *terminated*: it has failed, and its future reward is zero. Agents that are still racing after
    the first finish are *truncated*: the race would continue for them.

    Args:
        options: options of the episode.

    Attributes:
        reasons: why each ended agent's episode ended: ``"finish"``, ``"off_road"``,
            ``"wrong_way"``, ``"stuck"``, ``"first_finish"`` or ``"max_cycles"``.
    """

    def __init__(self, options: RaceOptions) -> None:
        limits = options.end_off_road, options.end_when_wrong_way, options.end_when_stuck
        self._limits = [np.inf if limit is None else limit for limit in limits]
        self._steps_left = options.end_when_first_finishes
        self.reasons: dict[str, str] = {}

    def end(
        self,
        ends: EndArrays,
        slots: npt.NDArray[np.intp],
        agents: Sequence[str],
        after: Snapshot,
        seconds: npt.NDArray[np.float64],
    ) -> None:
        """Adds the ends of a step.

        Args:
            ends: rewards, terminations and truncations of the step; changed in place.
            slots: ``(A,)`` slot of each agent.
            agents: the A agents that were still racing.
            after: snapshot after the step.
            seconds: ``(A, 3)`` float64, how long each agent's kart has been in each state of
                :data:`stkzoo.mdp.events.STREAKS` [s].
        """
        _, terminations, truncations = ends
        is_cut = self._is_cut(after)
        fails = seconds > np.array(self._limits) - 1e-6  # float sums are inexact
        for slot, agent, failed in zip(slots.tolist(), agents, fails.tolist(), strict=True):
            if terminations[slot]:
                self.reasons[agent] = "finish"
            elif any(failed):
                self.reasons[agent] = STREAKS[failed.index(True)]
                terminations[slot], truncations[slot] = True, False
            elif is_cut:
                self.reasons[agent], truncations[slot] = "first_finish", True
            elif truncations[slot]:
                self.reasons[agent] = "max_cycles"

    def _is_cut(self, after: Snapshot) -> bool:
        """Whether the chosen number of steps has passed since the first finish."""
        if self._steps_left is None or not after.karts["has_finished_race"].any():
            return False
        self._steps_left -= 1
        return self._steps_left < 0


def endings_of(options: RaceOptions) -> Endings | None:
    """Returns the ends that the options request; ``None`` if there are none."""
    chosen = (
        *(options.end_off_road, options.end_when_wrong_way, options.end_when_stuck),
        options.end_when_first_finishes,
    )
    return None if chosen == (None,) * 4 else Endings(options)
