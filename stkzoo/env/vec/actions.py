"""A batch of actions for all slots."""

from __future__ import annotations

from functools import cached_property
from typing import Any

from gymnasium import spaces
from gymnasium.vector.utils import iterate

from stkzoo.env.vec.batch_race import BatchRace
from stkzoo.errors import ActionError
from stkzoo.views.chains import CheckedActions


class ActionBatch:
    """The actions of one step.

    Args:
        batch: the actions as they came.
        space: action space of all slots.
        names: agent and race of each slot, for error messages.

    Attributes:
        batch: the actions as they came.
        num_slots: number of slots.
    """

    def __init__(self, batch: Any, space: spaces.Space[Any], names: list[str]) -> None:
        self.batch, self.num_slots = batch, len(names)
        self._space, self._names = space, names

    @cached_property
    def singles(self) -> list[Any]:
        """One action per slot.

        Raises:
            ActionError: the batch has another form, or another number of slots.
        """
        try:
            singles = list(iterate(self._space, self.batch))
        except (TypeError, LookupError, ValueError) as error:
            raise ActionError(
                f"the actions are {self.batch!r}, expected a batch for {self.num_slots} slots in "
                f"the form of {self._space}",
                self._names[0],
            ) from error
        if len(singles) != self.num_slots:
            raise ActionError(
                f"{len(singles)} actions came for {self.num_slots} slots ({self._names[0]} to "
                f"{self._names[-1]}); send one for each slot, including idle ones",
                self._names[0],
            )
        return singles

    def check_singly(self, race: BatchRace, slots: slice) -> CheckedActions:
        """Checks the actions of a race agent by agent.

        Args:
            race: the race.
            slots: its slots, in the order of its agents.

        Raises:
            ActionError: an action is invalid.
        """
        actions = dict(zip(race.possible_agents, self.singles[slots], strict=True))
        return race.check_actions(actions)
