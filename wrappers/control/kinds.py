"""What each of the two numbers of an action can mean."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from stkzoo.errors import unknown_name
from stkzoo.wrappers.control.kart import CarParameters

if TYPE_CHECKING:
    from typing_extensions import Self

FloatArray = npt.NDArray[np.floating[Any]]


class _ActionEnum(Enum):
    """The base of both kinds' names."""

    @classmethod
    def from_string(cls, name: str) -> Self:
        """The member of a name.

        Raises:
            ConfigError: there is none.
        """
        try:
            return cls(name)
        except ValueError:
            raise unknown_name("action", name, [kind.value for kind in cls]) from None

    def action(self, parameters: CarParameters) -> Any:
        """The part of a :class:`~stkzoo.wrappers.control.CarAction` that does it."""
        return _CLASSES[self](parameters)


class LongitudinalActionEnum(_ActionEnum):
    """The ways to ask for speed."""

    ACCL = "accl"
    SPEED = "speed"


class SteerActionEnum(_ActionEnum):
    """The ways to ask for a turn."""

    STEERING_ANGLE = "steering_angle"
    STEERING_SPEED = "steering_speed"


class NumberAction(ABC):
    """One number of an action.

    Attributes:
        names: of the actions of this kind.
        low: the smallest value of the number.
        high: the largest value.
    """

    names: ClassVar[type[_ActionEnum]]

    def __init__(self, parameters: CarParameters) -> None:
        self.parameters = parameters
        self.low, self.high = self.bounds()

    @classmethod
    def from_string(cls, name: str, parameters: CarParameters | None = None) -> Self:
        """The action of a name.

        Raises:
            ConfigError: there is none of that name.
        """
        action: Self = cls.names.from_string(name).action(parameters or CarParameters())
        return action

    @abstractmethod
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest value of the number."""


class LongitudinalAction(NumberAction):
    """Turns one number, ``"speed"`` or ``"accl"``, into the acceleration to drive with.

    Attributes:
        is_fed_back: whether what the kart does corrects what is asked for next.
    """

    names = LongitudinalActionEnum
    is_fed_back: bool

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

    def bounds(self) -> tuple[float, float]:
        """See :meth:`NumberAction.bounds`."""
        return self.parameters.v_min, self.parameters.v_max

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

    def bounds(self) -> tuple[float, float]:
        """See :meth:`NumberAction.bounds`."""
        return -self.parameters.a_max, self.parameters.a_max

    def act(self, value: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`LongitudinalAction.act`."""
        slowest = (self.parameters.v_min - speed) / step_size
        fastest = (self.parameters.v_max - speed) / step_size
        return np.clip(value, np.minimum(slowest, 0.0), np.maximum(fastest, 0.0))

    def read(self, accl: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`LongitudinalAction.read`."""
        del speed, step_size
        return np.clip(accl, self.low, self.high)


class SteerAction(NumberAction):
    """Turns one number, ``"steering_angle"`` or ``"steering_speed"``, into the angle of the wheels.

    Angles are positive to the right.
    """

    names = SteerActionEnum

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

    def bounds(self) -> tuple[float, float]:
        """See :meth:`NumberAction.bounds`."""
        return -self.parameters.s_max, self.parameters.s_max

    def rate(self, value: FloatArray, angle: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`SteerAction.rate`."""
        return (value - angle) / step_size

    def read(self, angle: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`SteerAction.read`."""
        del before, step_size
        return np.clip(angle, self.low, self.high)


class SteeringSpeedAction(SteerAction):
    """How fast the wheels turn [rad/s]; with 0 they stay where they are."""

    def bounds(self) -> tuple[float, float]:
        """See :meth:`NumberAction.bounds`."""
        return -self.parameters.sv_max, self.parameters.sv_max

    def rate(self, value: FloatArray, angle: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`SteerAction.rate`."""
        del angle, step_size
        return value

    def read(self, angle: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`SteerAction.read`."""
        return np.clip((angle - before) / step_size, self.low, self.high)


_CLASSES: dict[_ActionEnum, type[NumberAction]] = {
    LongitudinalActionEnum.ACCL: AcclAction,
    LongitudinalActionEnum.SPEED: SpeedAction,
    SteerActionEnum.STEERING_ANGLE: SteeringAngleAction,
    SteerActionEnum.STEERING_SPEED: SteeringSpeedAction,
}
