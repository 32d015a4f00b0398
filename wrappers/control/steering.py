"""Steering angle and steering speed as actions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.errors import unknown_name
from stkzoo.wrappers.control.parameters import CarParameters

__all__ = ["SteerAction", "SteerActionEnum", "SteeringAngleAction", "SteeringSpeedAction"]

FloatArray = npt.NDArray[np.floating[Any]]


class SteerActionEnum(Enum):
    """The ways to ask for a turn."""

    STEERING_ANGLE = "steering_angle"
    STEERING_SPEED = "steering_speed"

    @classmethod
    def from_string(cls, name: str) -> SteerActionEnum:
        """The member of a name.

        Raises:
            ConfigError: there is none.
        """
        try:
            return cls(name)
        except ValueError:
            raise unknown_name("steering action", name, [kind.value for kind in cls]) from None

    def action(self, parameters: CarParameters) -> SteerAction:
        """The part of a :class:`~stkzoo.wrappers.control.CarAction` that does it."""
        return _KINDS[self](parameters)


class SteerAction(ABC):
    """Turns one number of an action into the angle of the wheels, positive to the right.

    Attributes:
        low: the smallest value of the number.
        high: the largest value.
    """

    low: float
    high: float

    def __init__(self, parameters: CarParameters) -> None:
        self.parameters = parameters

    @staticmethod
    def from_string(name: str, parameters: CarParameters | None = None) -> SteerAction:
        """The action of a name, ``"steering_angle"`` or ``"steering_speed"``.

        Raises:
            ConfigError: there is none of that name.
        """
        return SteerActionEnum.from_string(name).action(parameters or CarParameters())

    @abstractmethod
    def rate(self, value: FloatArray, angle: FloatArray, step_size: float) -> FloatArray:
        """How fast the wheels are to turn [rad/s].

        Args:
            value: ``(...)`` what is asked for, from ``low`` to ``high``.
            angle: ``(...)`` the present angle of the wheels [rad].
            step_size: how long the action lasts [s].
        """

    def act(
        self, value: FloatArray, angle: FloatArray, max_angle: FloatArray, step_size: float
    ) -> FloatArray:
        """The angle of the wheels in the step that follows [rad].

        Args:
            value: ``(...)`` what is asked for, from ``low`` to ``high``.
            angle: ``(...)`` the present angle of the wheels [rad].
            max_angle: ``(...)`` the largest angle at the present speed [rad].
            step_size: how long the action lasts [s].
        """
        fastest = self.parameters.sv_max
        rate = np.clip(self.rate(value, angle, step_size), -fastest, fastest)
        return np.clip(angle + rate * step_size, -max_angle, max_angle)

    @abstractmethod
    def read(self, angle: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """What would have turned the wheels from one angle ``(...)`` to another."""


class SteeringAngleAction(SteerAction):
    """An angle of the wheels [rad], to which they turn as fast as they can."""

    def __init__(self, parameters: CarParameters) -> None:
        super().__init__(parameters)
        self.low, self.high = -parameters.s_max, parameters.s_max

    def rate(self, value: FloatArray, angle: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`SteerAction.rate`."""
        return (value - angle) / step_size

    def read(self, angle: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`SteerAction.read`."""
        del before, step_size
        return np.clip(angle, self.low, self.high)


class SteeringSpeedAction(SteerAction):
    """How fast the wheels turn [rad/s]; with 0 they stay where they are."""

    def __init__(self, parameters: CarParameters) -> None:
        super().__init__(parameters)
        self.low, self.high = -parameters.sv_max, parameters.sv_max

    def rate(self, value: FloatArray, angle: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`SteerAction.rate`."""
        del angle, step_size
        return value

    def read(self, angle: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`SteerAction.read`."""
        return np.clip((angle - before) / step_size, self.low, self.high)


_KINDS: dict[SteerActionEnum, type[SteerAction]] = {
    SteerActionEnum.STEERING_ANGLE: SteeringAngleAction,
    SteerActionEnum.STEERING_SPEED: SteeringSpeedAction,
}
