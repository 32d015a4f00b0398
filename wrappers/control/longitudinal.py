"""Speed and acceleration as actions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.errors import unknown_name
from stkzoo.wrappers.control.parameters import CarParameters

__all__ = ["AcclAction", "LongitudinalAction", "LongitudinalActionEnum", "SpeedAction"]

FloatArray = npt.NDArray[np.floating[Any]]


class LongitudinalActionEnum(Enum):
    """The ways to ask for speed."""

    ACCL = "accl"
    SPEED = "speed"

    @classmethod
    def from_string(cls, name: str) -> LongitudinalActionEnum:
        """The member of a name.

        Raises:
            ConfigError: there is none.
        """
        try:
            return cls(name)
        except ValueError:
            raise unknown_name("longitudinal action", name, [kind.value for kind in cls]) from None

    def action(self, parameters: CarParameters) -> LongitudinalAction:
        """The part of a :class:`~stkzoo.wrappers.control.CarAction` that does it."""
        return _KINDS[self](parameters)


class LongitudinalAction(ABC):
    """Turns one number of an action into the acceleration to drive with.

    Attributes:
        low: the smallest value of the number.
        high: the largest value.
        is_fed_back: whether what the kart does corrects what is asked for next.
    """

    low: float
    high: float
    is_fed_back: bool

    def __init__(self, parameters: CarParameters) -> None:
        self.parameters = parameters

    @staticmethod
    def from_string(name: str, parameters: CarParameters | None = None) -> LongitudinalAction:
        """The action of a name, ``"speed"`` or ``"accl"``.

        Raises:
            ConfigError: there is none of that name.
        """
        return LongitudinalActionEnum.from_string(name).action(parameters or CarParameters())

    @abstractmethod
    def act(self, value: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """The acceleration to drive with [m/s^2].

        Args:
            value: ``(...)`` what is asked for, from ``low`` to ``high``.
            speed: ``(...)`` forward speed [m/s].
            step_size: how long the action lasts [s].
        """

    @abstractmethod
    def read(self, accl: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """What would have asked for an acceleration ``(...)``: the other way of :meth:`act`."""


class SpeedAction(LongitudinalAction):
    """A speed to reach and hold [m/s], by a proportional controller."""

    is_fed_back = True

    def __init__(self, parameters: CarParameters) -> None:
        super().__init__(parameters)
        self.low, self.high = parameters.v_min, parameters.v_max

    def act(self, value: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`LongitudinalAction.act`."""
        return (value - speed) * self._gain(step_size)

    def read(self, accl: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`LongitudinalAction.read`."""
        return np.clip(speed + accl / self._gain(step_size), self.low, self.high)

    def _gain(self, step_size: float) -> float:
        """No step may overshoot, so long steps want less gain [1/s]."""
        return min(self.parameters.speed_gain, 0.8 / step_size)


class AcclAction(LongitudinalAction):
    """An acceleration [m/s^2], between the lowest and the highest speed."""

    is_fed_back = False

    def __init__(self, parameters: CarParameters) -> None:
        super().__init__(parameters)
        self.low, self.high = -parameters.a_max, parameters.a_max

    def act(self, value: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`LongitudinalAction.act`."""
        slowest = (self.parameters.v_min - speed) / step_size
        fastest = (self.parameters.v_max - speed) / step_size
        return np.clip(value, np.minimum(slowest, 0.0), np.maximum(fastest, 0.0))

    def read(self, accl: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`LongitudinalAction.read`."""
        del speed, step_size
        return np.clip(accl, self.low, self.high)


_KINDS: dict[LongitudinalActionEnum, type[LongitudinalAction]] = {
    LongitudinalActionEnum.ACCL: AcclAction,
    LongitudinalActionEnum.SPEED: SpeedAction,
}
