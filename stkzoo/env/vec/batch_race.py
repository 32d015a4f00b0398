"""A race that reads actions from a batch and writes its results into rows of batches."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.env.vec.ahead import AheadRace
from stkzoo.env.vec.steps import InfoTables, IntArray, SlotSteps


class BatchRace(AheadRace):
    """A race with a second form of its steps, in which nothing is made for single agents.

    The agents' actions and results are rows of arrays over the slots of all races. The results are
    those of :meth:`decode` and :meth:`step_wait`, to the bit.

    Args:
        **options: options of :class:`~stkzoo.env.vec.ahead.AheadRace`.

    Raises:
        ConfigError: an option is invalid, or not supported in a vector environment.
    """

    @property
    def has_rows(self) -> bool:
        """Whether the kernel runs all wrappers of all agents, so that the methods below work."""
        return self._chains.has_rows

    def decode_batch(
        self, actions: Any, slots: IntArray, num_slots: int
    ) -> npt.NDArray[np.float32] | None:
        """Does the same as :meth:`decode` for a batch of actions.

        Args:
            actions: an array with one row per slot, or a dict of such arrays.
            slots: slot of each racing agent.
            num_slots: number of slots in the batch.

        Returns:
            The controls; ``None`` if an action is invalid or in an unusual form.

        Raises:
            ApiOrderError: called before the first ``reset``, or while a step is running.
        """
        episode, agents = self._idle_episode(), self.agents
        rows = episode.player_rows(agents)
        size = episode.num_players
        return self._chains.decode_batch(actions, slots, num_slots, agents, rows, size, episode)

    def step_into(self, steps: SlotSteps, slots: IntArray) -> None:
        """Waits for the step and writes the rewards and ends of the agents that acted.

        Args:
            steps: steps of all slots.
            slots: slot of each racing agent.

        Raises:
            ApiOrderError: called without :meth:`send`.
            EngineError: the game crashed or hung; ``reset`` starts a new race.
        """
        with self._turn.of("step_wait"):
            episode, agents = self._awaited_episode(), self.agents
            ends = steps.rewards, steps.terminations, steps.truncations
            episode.advance_into(self._session.step_wait(), agents, slots, ends)
            has_ended = steps.terminations[slots] | steps.truncations[slots]
            if has_ended.any():
                self.agents = [
                    agent
                    for agent, ended in zip(agents, has_ended.tolist(), strict=True)
                    if not ended
                ]

    def show_in(self, steps: SlotSteps, slots: IntArray) -> None:
        """Writes the current observations and infos of the racing agents.

        Args:
            steps: steps of all slots, with infos in tables.
            slots: slot of each racing agent.
        """
        episode, agents = self._running("observe"), self.agents
        self._chains.observe_into(agents, episode, slots, steps.observations)
        if isinstance(steps.infos, InfoTables):
            table = steps.infos.of(episode.info_keys)
            episode.infos_into(agents, slots, table.values)
            table.has[slots] = True
