"""A race that reads actions from a batch and writes its results into rows of batches."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.env.vec.ahead import AheadRace
from stkzoo.env.vec.steps import InfoTables, IntArray, SlotSteps
from stkzoo.views.chains import CheckedActions


class BatchRace(AheadRace):
    """A race whose steps can also read and write batches, without objects for single agents.

    The agents' actions and results are rows of arrays over the slots of all races. The results are
    those of :meth:`decode` and :meth:`step_wait`, bit for bit. Actions are checked in a separate
    call, so that those of all races are checked before any wrapper runs.

    Args:
        **options: options of :class:`~stkzoo.env.vec.ahead.AheadRace`.

    Raises:
        ConfigError: an option is invalid, or not supported in a vector environment.
    """

    @property
    def has_rows(self) -> bool:
        """Whether the kernel runs all wrappers of all agents, so that the results can be rows."""
        return self._chains.has_rows

    def check_actions(self, actions: Mapping[str, Any]) -> CheckedActions:
        """First half of :meth:`decode`: checks the actions and changes nothing.

        Args:
            actions: see :meth:`step`.

        Raises:
            ActionError: an action is missing or invalid.
            ApiOrderError: called before the first ``reset``, or while a step is running.
        """
        return self._chains.check(actions, self._idle_episode().seats(self.agents))

    def check_batch(self, actions: Any, slots: IntArray, num_slots: int) -> CheckedActions | None:
        """Does the same as :meth:`check_actions` for a batch of actions; see :attr:`has_rows`.

        Args:
            actions: an array with one row per slot, or a dict of such arrays.
            slots: slot of each racing agent.
            num_slots: number of slots in the batch.

        Returns:
            The actions; ``None`` if one is invalid or in an unusual form.

        Raises:
            ApiOrderError: called before the first ``reset``, or while a step is running.
        """
        seats = self._idle_episode().seats(self.agents)
        return self._chains.check_batch(actions, slots, num_slots, seats)

    def convert(self, actions: CheckedActions) -> npt.NDArray[np.float32]:
        """Second half of :meth:`decode`: converts checked actions to controls.

        Args:
            actions: actions from :meth:`check_actions` or :meth:`check_batch`.

        Raises:
            ActionError: a wrapper returned an invalid action.
            AgentException: a wrapper failed.
        """
        return self._chains.convert(actions, self._idle_episode())

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
            try:
                snapshot = self._session.step_wait()
                episode.advance_into(snapshot, episode.seats(agents), slots, ends)
            finally:
                self._stepping = None
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
        episode = self._running("observe")
        seats = episode.seats(self.agents)
        self._chains.observe_into(seats, episode, slots, steps.observations)
        if isinstance(steps.infos, InfoTables):
            table = steps.infos.of(episode.info_keys)
            episode.infos_into(seats, slots, table.values)
            table.has[slots] = True
