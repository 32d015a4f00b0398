"""Views of agents that act in physical units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym

from stkzoo.errors import unknown_name
from stkzoo.wrappers.control.parameters import CarParameters
from stkzoo.wrappers.control.wrapper import ControlWrapper
from stkzoo.wrappers.flattening import FlattenerWrapper
from stkzoo.wrappers.observations import ConstantSizedObservations, PolarObservations

__all__ = ["ControlView"]

_OBSERVED = ("full", "simple", "flattened")


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlView:
    """A view for ``view=`` and ``stkzoo.register_view``: a function that wraps one kart.

    Attributes:
        observe: what the agent sees: as in the view ``"full"``, ``"simple"`` or
            ``"flattened"``. With ``"flattened"`` the action is a plain ``Box(2)`` without
            buttons, else a dict of ``continuous`` and ``discrete``.
        control_input: see :class:`~stkzoo.wrappers.control.ControlWrapper`, as for all that
            follow.
        normalize_act: whether both numbers go from -1 to 1.
        buttons: the game's own buttons beside them.
        kart: whose limits to take, as in ``AgentSpec.kart``.
        step_size: that of the race [s].
    """

    observe: str = "simple"
    control_input: str | Sequence[str] = ("speed", "steering_angle")
    normalize_act: bool = False
    buttons: Sequence[str] = ()
    kart: str = ""
    step_size: float = 0.1

    def __post_init__(self) -> None:
        if self.observe not in _OBSERVED:
            raise unknown_name("view to observe", self.observe, _OBSERVED)

    def __call__(self, env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
        """The environment, wrapped."""
        if self.observe != "full":
            env = PolarObservations(ConstantSizedObservations(env))
        wrapped = ControlWrapper(
            env,
            control_input=self.control_input,
            normalize_act=self.normalize_act,
            buttons=self.buttons,
            parameters=CarParameters.of_kart(self.kart),
            step_size=self.step_size,
        )
        return FlattenerWrapper(wrapped) if self.observe == "flattened" else wrapped
