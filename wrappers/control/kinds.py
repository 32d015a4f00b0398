"""What each of the two numbers of an action can mean."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from enum import Enum
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.errors import check_flag, unknown_name
from stkzoo.wrappers.control.kart import CarParameters

FloatArray = npt.NDArray[np.floating[Any]]


class _ActionEnum(Enum):
    """The base of both kinds' names."""

    @classmethod
    def is_valid(cls, name: object) -> bool:
        """Whether there is a member of that name."""
        return name in [kind.value for kind in cls]

    @classmethod
    def from_string(cls, name: str) -> type[Any]:
        """The class of a name, such as :class:`SpeedAction` for ``"speed"``.

        Raises:
            ConfigError: there is none.
        """
        if not cls.is_valid(name):
            raise unknown_name("action", name, [kind.value for kind in cls])
        return _CLASSES[name]


class LongitudinalActionEnum(_ActionEnum):
    """The ways to ask for speed; the second spelling of each is F1TENTH gymkhana's."""

    ACCL = Accl = "accl"
    SPEED = Speed = "speed"


class SteerActionEnum(_ActionEnum):
    """The ways to ask for a turn; the second spelling of each is F1TENTH gymkhana's."""

    STEERING_ANGLE = Steering_Angle = "steering_angle"
    STEERING_SPEED = Steering_Speed = "steering_speed"


class NumberAction(ABC):
    """One number of an action.

    Attributes:
        type: what the number means, such as ``"speed"``.
        low: its smallest value, in physical units.
        high: its largest value.
        normalize: whether it is given from -1 to 1 instead, for the whole of that range.
        params: the kart's limits.

    Args:
        params: the kart's limits, or a mapping of some of them; by default those of the
            game's default kart.
        normalize: whether the number is from -1 to 1.

    Raises:
        ConfigError: an argument is invalid.
    """

    type: ClassVar[str]

    def __init__(
        self,
        params: CarParameters | Mapping[str, float] | None = None,
        normalize: bool = False,
    ) -> None:
        self.params = CarParameters.of(params)
        self.normalize = check_flag("normalize", normalize)
        self.low, self.high = self.bounds()

    @property
    def lower_limit(self) -> float:
        """The smallest value that is given: ``low``, or -1 if normalized."""
        return -1.0 if self.normalize else self.low

    @property
    def upper_limit(self) -> float:
        """The largest value that is given: ``high``, or 1 if normalized."""
        return 1.0 if self.normalize else self.high

    @property
    def space(self) -> spaces.Box:
        """The values that are given, ``()`` float32."""
        return spaces.Box(self.lower_limit, self.upper_limit, (), np.float32)

    @abstractmethod
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest value in physical units."""


class LongitudinalAction(NumberAction):
    """Turns one number, ``"speed"`` or ``"accl"``, into the acceleration to drive with.

    Attributes:
        is_fed_back: whether what the kart does corrects what is asked for next.
    """

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

    type = "speed"
    is_fed_back = True

    def bounds(self) -> tuple[float, float]:
        """See :meth:`NumberAction.bounds`."""
        return self.params.v_min, self.params.v_max

    def act(self, value: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`LongitudinalAction.act`."""
        return (value - speed) * self._gain(step_size)

    def read(self, accl: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`LongitudinalAction.read`."""
        return np.clip(speed + accl / self._gain(step_size), self.low, self.high)

    def _gain(self, step_size: float) -> float:
        """No step may overshoot, so long steps want less gain [1/s]."""
        return min(self.params.speed_gain, 0.8 / step_size)


class AcclAction(LongitudinalAction):
    """An acceleration [m/s^2], between the lowest and the highest speed."""

    type = "accl"
    is_fed_back = False

    def bounds(self) -> tuple[float, float]:
        """See :meth:`NumberAction.bounds`."""
        return -self.params.a_max, self.params.a_max

    def act(self, value: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`LongitudinalAction.act`."""
        slowest = (self.params.v_min - speed) / step_size
        fastest = (self.params.v_max - speed) / step_size
        return np.clip(value, np.minimum(slowest, 0.0), np.maximum(fastest, 0.0))

    def read(self, accl: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`LongitudinalAction.read`."""
        del speed, step_size
        return np.clip(accl, self.low, self.high)


class SteerAction(NumberAction):
    """Turns one number, ``"steering_angle"`` or ``"steering_speed"``, into the angle of the wheels.

    Angles are positive to the right.
    """

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
        fastest = self.params.sv_max
        rate = np.clip(self.rate(value, angle, step_size), -fastest, fastest)
        return np.clip(angle + rate * step_size, -max_angle, max_angle)

    @abstractmethod
    def read(self, angle: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """What would have turned the wheels from one angle ``(...)`` to another."""


class SteeringAngleAction(SteerAction):
    """An angle of the wheels [rad], reached as fast as ``sv_max`` and ``T_steer`` allow."""

    type = "steering_angle"

    def bounds(self) -> tuple[float, float]:
        """See :meth:`NumberAction.bounds`."""
        return -self.params.s_max, self.params.s_max

    def rate(self, value: FloatArray, angle: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`SteerAction.rate`."""
        return (value - angle) / step_size * self._share(step_size)

    def read(self, angle: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`SteerAction.read`."""
        if self.params.T_steer > 0:
            angle = before + (angle - before) / self._share(step_size)
        return np.clip(angle, self.low, self.high)

    def _share(self, step_size: float) -> float:
        """The share of the way that the wheels cover in a step."""
        lag = self.params.T_steer
        return 1.0 - math.exp(-step_size / lag) if lag > 0 else 1.0


class SteeringSpeedAction(SteerAction):
    """How fast the wheels turn [rad/s]; with 0 they stay where they are."""

    type = "steering_speed"

    def bounds(self) -> tuple[float, float]:
        """See :meth:`NumberAction.bounds`."""
        return -self.params.sv_max, self.params.sv_max

    def rate(self, value: FloatArray, angle: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`SteerAction.rate`."""
        del angle, step_size
        return value

    def read(self, angle: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`SteerAction.read`."""
        return np.clip((angle - before) / step_size, self.low, self.high)


_CLASSES: dict[str, type[NumberAction]] = {
    kind.type: kind for kind in (AcclAction, SpeedAction, SteeringAngleAction, SteeringSpeedAction)
}
