"""The meanings of the two numbers of an action."""

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
    """Base class of both enumerations."""

    @classmethod
    def is_valid(cls, name: object) -> bool:
        """Returns whether a member with a name exists."""
        return name in [kind.value for kind in cls]

    @classmethod
    def from_string(cls, name: str) -> type[Any]:
        """Returns the class for a name, such as :class:`SpeedAction` for ``"speed"``.

        Raises:
            ConfigError: the name does not exist.
        """
        if not cls.is_valid(name):
            raise unknown_name("action", name, [kind.value for kind in cls])
        return _CLASSES[name]


class LongitudinalActionEnum(_ActionEnum):
    """Kinds of longitudinal actions."""

    ACCL = "accl"
    SPEED = "speed"


class SteerActionEnum(_ActionEnum):
    """Kinds of steering actions."""

    STEERING_ANGLE = "steering_angle"
    STEERING_SPEED = "steering_speed"


class NumberAction(ABC):
    """One number of an action.

    Attributes:
        type: meaning of the number, such as ``"speed"``.
        low: smallest value, in physical units.
        high: largest value, in physical units.
        normalize: whether that range is scaled to [-1, 1].
        params: limits of the kart.

    Args:
        params: limits of the kart, or a mapping of some of them; by default, those of the game's
            default kart.
        normalize: whether to scale the range to [-1, 1].

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
        """Smallest value of an action: ``low``, or -1 if normalized."""
        return -1.0 if self.normalize else self.low

    @property
    def upper_limit(self) -> float:
        """Largest value of an action: ``high``, or 1 if normalized."""
        return 1.0 if self.normalize else self.high

    @property
    def space(self) -> spaces.Box:
        """Space of an action, ``()`` float32."""
        return spaces.Box(self.lower_limit, self.upper_limit, (), np.float32)

    @abstractmethod
    def bounds(self) -> tuple[float, float]:
        """Returns the smallest and the largest value in physical units."""


class LongitudinalAction(NumberAction):
    """Converts one number, ``"speed"`` or ``"accl"``, to an acceleration.

    Attributes:
        is_fed_back: whether the measured motion corrects the next request.
    """

    is_fed_back: bool

    @abstractmethod
    def act(self, value: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """Returns the acceleration for a value [m/s^2].

        Args:
            value: ``(...)`` requested value, from ``low`` to ``high``.
            speed: ``(...)`` forward speed [m/s].
            step_size: duration of the action [s].
        """

    @abstractmethod
    def read(self, accl: FloatArray, speed: FloatArray, step_size: float) -> FloatArray:
        """Returns the value for an acceleration ``(...)`` [m/s^2]; the inverse of :meth:`act`."""


class SpeedAction(LongitudinalAction):
    """A target speed [m/s], reached and held by a proportional controller."""

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
        """Returns the controller's gain [1/s], reduced for long steps so that none overshoots."""
        return min(self.params.speed_gain, 0.8 / step_size)


class AcclAction(LongitudinalAction):
    """An acceleration [m/s^2], within the limits of speed."""

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
    """Converts one number, ``"steering_angle"`` or ``"steering_speed"``, to the wheel angle.

    Angles are positive to the right.
    """

    @abstractmethod
    def rate(self, value: FloatArray, angle: FloatArray, step_size: float) -> FloatArray:
        """Returns the requested turning speed of the wheels [rad/s].

        Args:
            value: ``(...)`` requested value, from ``low`` to ``high``.
            angle: ``(...)`` current wheel angle [rad].
            step_size: duration of the action [s].
        """

    def act(
        self, value: FloatArray, angle: FloatArray, max_angle: FloatArray, step_size: float
    ) -> FloatArray:
        """Returns the wheel angle in the next step [rad].

        Args:
            value: ``(...)`` requested value, from ``low`` to ``high``.
            angle: ``(...)`` current wheel angle [rad].
            max_angle: ``(...)`` largest wheel angle at the current speed [rad].
            step_size: duration of the action [s].
        """
        fastest = self.params.sv_max
        rate = np.clip(self.rate(value, angle, step_size), -fastest, fastest)
        return np.clip(angle + rate * step_size, -max_angle, max_angle)

    @abstractmethod
    def read(self, angle: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """Returns the value that turns the wheels from ``before`` to ``angle`` [rad], ``(...)``."""


class SteeringAngleAction(SteerAction):
    """A wheel angle [rad], reached as fast as ``sv_max`` and ``T_steer`` allow."""

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
        """Returns the fraction of the remaining angle that the wheels cover in a step."""
        lag = self.params.T_steer
        return 1.0 - math.exp(-step_size / lag) if lag > 0 else 1.0


class SteeringSpeedAction(SteerAction):
    """Turning speed of the wheels [rad/s]; with 0 they keep their angle."""

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
