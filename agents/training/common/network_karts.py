"""Networks that answer at once in the races of a fleet, which is made for drivers by plans."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from stkzoo.agents.planning import PolicyInput
from stkzoo.agents.pretrained.action_filter import INPUT_SIZE, ActionFilter
from stkzoo.wrappers.racing import SIZE, controls_of_choices

from .fleet import Fleet

__all__ = ["NetworkKarts", "seen_by_networks"]


def seen_by_networks(view: PolicyInput) -> npt.NDArray[Any]:
    """What networks see of what drivers by plans do, ``(S, 177)``: theirs begins with it."""
    return view.inputs[:, :INPUT_SIZE]


class NetworkKarts:
    """The karts of a fleet, none of them mirrored, driven by networks' choices.

    Args:
        fleet: the races.
        hold: for how many steps a drift is held.
    """

    def __init__(self, fleet: Fleet, hold: int) -> None:
        self._fleet = fleet
        self._action_filter = ActionFilter(fleet.num_slots, hold, fleet.drivers.memory)

    def send(self, view: PolicyInput, choices: npt.NDArray[Any]) -> None:
        """Asks all races for a step.

        Args:
            view: what is seen.
            choices: ``(S, 5)`` of the view ``racing``.
        """
        self._action_filter.see(view.inputs[:, :SIZE])
        self._fleet.control(controls_of_choices(self._action_filter.apply(choices)))
