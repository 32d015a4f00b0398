"""Ends of an agent's episode other than its kart's finish, by choice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.env.options import RaceOptions
from stkzoo.mdp.events import STREAKS

#: Rewards, terminations and truncations, each by agent.
Ends = tuple[dict[str, float], dict[str, bool], dict[str, bool]]


class Endings:
    """Ends the episodes of agents that fail, and of all others once a kart has finished.

    An agent whose kart is stuck, drives the wrong way or is off the road for too long is
    *terminated*: it has failed, and nothing that it could have earned later counts. Those who are
    left when the first kart has finished are *truncated*: the race goes on, only not for them.

    Args:
        options: of the episode.

    Attributes:
        reasons: why agents' episodes have ended, by agent: ``"finish"``, ``"off_road"``,
            ``"wrong_way"``, ``"stuck"``, ``"first_finish"`` or ``"max_cycles"``.
    """

    def __init__(self, options: RaceOptions) -> None:
        limits = options.end_off_road, options.end_when_wrong_way, options.end_when_stuck
        self._limits = [np.inf if limit is None else limit for limit in limits]
        self._steps_left = options.end_when_first_finishes
        self.reasons: dict[str, str] = {}

    def end(
        self,
        ends: Ends,
        agents: Sequence[str],
        karts: npt.NDArray[np.intp],
        after: Snapshot,
        seconds: npt.NDArray[np.float64],
    ) -> None:
        """Adds the ends of a step.

        Args:
            ends: the step's, which are changed.
            agents: the agents that were still racing.
            karts: ``(A,)`` their karts.
            after: the moment after the step.
            seconds: ``(K, 3)``: for how long karts have been in each of
                :data:`stkzoo.mdp.events.STREAKS` [s].
        """
        _, terminations, truncations = ends
        is_cut = self._is_cut(after)
        fails = seconds[karts] > np.array(self._limits) - 1e-6  # sums of steps are not exact
        for agent, failed in zip(agents, fails.tolist(), strict=True):
            if terminations[agent]:
                self.reasons[agent] = "finish"
            elif any(failed):
                self.reasons[agent] = STREAKS[failed.index(True)]
                terminations[agent], truncations[agent] = True, False
            elif is_cut:
                self.reasons[agent], truncations[agent] = "first_finish", True
            elif truncations[agent]:
                self.reasons[agent] = "max_cycles"

    def _is_cut(self, after: Snapshot) -> bool:
        """Whether so many steps have passed since the first kart finished."""
        if self._steps_left is None or not after.karts["has_finished_race"].any():
            return False
        self._steps_left -= 1
        return self._steps_left < 0


def endings_of(options: RaceOptions) -> Endings | None:
    """What ends episodes by these options; ``None`` if they ask for nothing."""
    chosen = (
        *(options.end_off_road, options.end_when_wrong_way, options.end_when_stuck),
        options.end_when_first_finishes,
    )
    return None if chosen == (None,) * 4 else Endings(options)
