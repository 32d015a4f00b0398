"""An action of two numbers in physical units, and its conversion to the game's controls."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from stkzoo._checks import check_flag, check_whole, unknown_name
from stkzoo.errors import ConfigError
from stkzoo.kernel import CarController
from stkzoo.wrappers.control.kart import PEDALS, CarParameters, Pedals

FloatArray = npt.NDArray[np.floating[Any]]


class _ActionEnum(Enum):
    """Base class of both enumerations."""

    @classmethod
    def is_valid(cls, name: object) -> bool:
        """Returns whether a member with a name exists."""
        return name in [member.value for member in cls]

    @classmethod
    def from_string(cls, name: str) -> type[Any]:
        """Returns the class for a name, such as :class:`SpeedAction` for ``"speed"``.

        Raises:
            ConfigError: the name does not exist.
        """
        if not cls.is_valid(name):
            raise unknown_name("action", name, [member.value for member in cls])
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
        lower_limit: smallest value of an action: ``low``, or -1 if normalized.
        upper_limit: largest value of an action: ``high``, or 1 if normalized.
        space: space of an action, ``()`` float32.

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
        self.low, self.high = limits = self.bounds()
        self.lower_limit, self.upper_limit = (-1.0, 1.0) if self.normalize else limits
        self.space = spaces.Box(self.lower_limit, self.upper_limit, (), np.float32)

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
    each.type: each for each in (AcclAction, SpeedAction, SteeringAngleAction, SteeringSpeedAction)
}


class CarAction:
    """An action of two numbers, ``[steering, longitudinal]``, in physical units.

    The numbers always have this order, whatever the order of the names, as in F1TENTH gymkhana. All
    methods are pure functions over arrays with any leading axes.

    Attributes:
        type: names of both numbers, in their order.
        longitudinal: meaning of the second number.
        steering: meaning of the first number.
        space: ``(2,)`` float32, in physical units or in [-1, 1].
        steer_bounds: lower and upper bound of the first number in ``space``.
        throttle_bounds: lower and upper bound of the second number in ``space``.
        params: limits of the kart.

    Args:
        control_input: one of ``"speed"`` [m/s] and ``"accl"`` [m/s^2], and one of
            ``"steering_angle"`` [rad] and ``"steering_speed"`` [rad/s]. A single name is completed
            with ``"speed"`` or ``"steering_angle"``.
        normalize: scale the range of both numbers to [-1, 1]. 0 is then the middle of the range,
            which for ``"speed"`` is not standstill.
        params: limits of the kart, or a mapping of some of them; by default, those of the game's
            default kart.

    Raises:
        ConfigError: a name is unknown, or both names are of one kind.
    """

    def __init__(
        self,
        control_input: str | Sequence[str] = ("speed", "steering_angle"),
        params: CarParameters | Mapping[str, float] | None = None,
        normalize: bool = False,
    ) -> None:
        self.params = CarParameters.of(params)
        longitudinal, steering = _kinds(control_input)
        self.longitudinal: LongitudinalAction = longitudinal(self.params, normalize)
        self.steering: SteerAction = steering(self.params, normalize)
        self.type = self.steering.type, self.longitudinal.type
        self.normalize = check_flag("normalize", normalize)
        self._low = np.array([self.steering.low, self.longitudinal.low], np.float32)
        self._high = np.array([self.steering.high, self.longitudinal.high], np.float32)
        self.steer_bounds = self.steering.lower_limit, self.steering.upper_limit
        self.throttle_bounds = self.longitudinal.lower_limit, self.longitudinal.upper_limit
        low, high = zip(self.steer_bounds, self.throttle_bounds, strict=True)
        self.space = spaces.Box(np.array(low, np.float32), np.array(high, np.float32))
        self._pedals = Pedals()

    def new_controller(self, columns: Sequence[str]) -> CarController:
        """Returns the compiled form of :meth:`act`, ``stkzoo/kernel/car_controller.c``.

        Args:
            columns: names of the game's controls.
        """
        kart, limits = self.params, (self._low, self._high)
        return CarController(
            (
                self.longitudinal.is_fed_back,
                self.steering.type == "steering_angle",
                self.normalize,
            ),
            (
                *(float(limit[number]) for number in (0, 1) for limit in limits),
                *(kart.v_min, kart.v_max, kart.sv_max, kart.speed_gain, kart.T_steer),
            ),
            PEDALS,
            (columns.index("acceleration"), columns.index("steer"), columns.index("brake")),
            len(columns),
        )

    def memory(self, shape: tuple[int, ...] = ()) -> FloatArray:
        """Returns the initial memory for :meth:`act`, ``(*shape, 2)`` zeros.

        The memory holds the wheel angle [rad] and the remaining speed change [m/s]: throttle and
        brake cannot produce every acceleration, so the rest is carried over.
        """
        return np.zeros((*shape, 2))

    def act(
        self,
        action: FloatArray,
        speed: FloatArray,
        max_steer_angle: FloatArray,
        memory: FloatArray,
        step_size: float = 0.1,
    ) -> tuple[FloatArray, FloatArray]:
        """Converts an action to the game's controls.

        ``stkzoo/kernel/car_controller.c`` is the compiled form of this method, with the same bits.

        Args:
            action: ``(..., 2)`` in ``space``.
            speed: ``(...)`` forward speed, as observed in ``velocity[2]`` [m/s].
            max_steer_angle: ``(...)`` as observed [rad].
            memory: ``(..., 2)`` from :meth:`memory` or from the previous call.
            step_size: duration of the action [s].

        Returns:
            Controls ``(..., 3)``: ``acceleration`` in [0, 1], ``steer`` in [-1, 1], ``brake`` 0 or
                1; and the memory for the next call.
        """
        asked = self.physical(action)
        most = np.maximum(max_steer_angle, 1e-3)
        angle = self.steering.act(asked[..., 0], memory[..., 0], most, step_size)
        accl = self.longitudinal.act(asked[..., 1], speed, step_size)
        owed = np.zeros_like(accl)
        if not self.longitudinal.is_fed_back:
            wanted = self._pedals.reach(accl, speed) + memory[..., 1] / step_size
            throttle, brake = self._pedals.press(wanted, speed, step_size)
            reached = self._pedals.effect(throttle, brake, speed, step_size)
            owed = np.clip((wanted - reached) * step_size, -2.0, 2.0)
        else:
            throttle, brake = self._pedals.press(accl, speed, step_size)
        controls = np.stack([throttle, angle / most, brake.astype(np.float64)], axis=-1)
        return controls, np.stack([angle, owed], axis=-1)

    def physical(self, action: FloatArray) -> FloatArray:
        """Converts an action ``(..., 2)`` in ``space`` to physical units, float64."""
        values = np.asarray(action, np.float64)
        low, high = self._low.astype(np.float64), self._high.astype(np.float64)
        return low + (values + 1.0) / 2.0 * (high - low) if self.normalize else values

    def read(
        self,
        controls: FloatArray,
        speed: FloatArray,
        max_steer_angle: FloatArray,
        angle_before: FloatArray,
        step_size: float = 0.1,
    ) -> FloatArray:
        """Returns the action equivalent to controls of the game; the inverse of :meth:`act`.

        Args:
            controls: ``(..., 3)``: ``acceleration``, ``steer`` and ``brake``.
            speed: ``(...)`` forward speed [m/s].
            max_steer_angle: ``(...)`` [rad].
            angle_before: ``(...)`` previous wheel angle [rad].
            step_size: duration of the controls [s].

        Returns:
            ``(..., 2)`` float32 in ``space``.
        """
        throttle, steer, brake = np.moveaxis(np.asarray(controls, np.float64), -1, 0)
        accl = self._pedals.effect(throttle, brake > 0, speed, step_size)
        numbers = [
            self.steering.read(steer * max_steer_angle, angle_before, step_size),
            self.longitudinal.read(accl, speed, step_size),
        ]
        return self._in_space(np.stack(np.broadcast_arrays(*numbers), axis=-1))

    def held(self, controls: FloatArray) -> FloatArray:
        """Returns the action for keys that are held down, independent of the kart's speed.

        Full throttle requests the maximum of the longitudinal number, the brake its minimum, and
        neither key 0; full steering requests an extreme of the steering number.

        Args:
            controls: ``(..., 3)``: ``acceleration``, ``steer`` and ``brake``.

        Returns:
            ``(..., 2)`` float32 in ``space``.
        """
        throttle, steer, brake = np.moveaxis(np.asarray(controls, np.float64), -1, 0)
        pushed = np.stack([steer, np.where(brake > 0, -1.0, throttle)], axis=-1)
        return self._in_space(np.where(pushed < 0, -pushed * self._low, pushed * self._high))

    def _in_space(self, action: FloatArray) -> FloatArray:
        """Converts an action ``(..., 2)`` in physical units to ``space``, float32."""
        if self.normalize:
            action = (action - self._low) / (self._high - self._low) * 2.0 - 1.0
        inside: FloatArray = np.clip(action, self.space.low, self.space.high).astype(np.float32)
        return inside


def from_single_to_multi_action_space(
    single_action_space: spaces.Space[Any], num_agents: int
) -> spaces.Space[Any]:
    """Returns the joint action space of several agents: ``(num_agents, 2)`` for a ``(2,)`` ``Box``.

    Args:
        single_action_space: action space of one agent.
        num_agents: number of agents.

    Raises:
        ConfigError: ``num_agents`` is below 1.
    """
    return batch_space(single_action_space, check_whole("num_agents", num_agents, 1))


def _kinds(control_input: object) -> tuple[type[LongitudinalAction], type[SteerAction]]:
    """Returns the classes of both numbers."""
    names = [control_input] if isinstance(control_input, str) else control_input
    if not isinstance(names, Sequence) or not 1 <= len(names) <= 2:
        raise ConfigError(f"control_input is {control_input!r}, {_EXPECTED}")
    for name in names:
        if not isinstance(name, str) or name not in _CLASSES:
            raise ConfigError(f"control_input has {name!r}, {_EXPECTED}")
    kinds = [_CLASSES[name] for name in names]
    longitudinal = [number for number in kinds if issubclass(number, LongitudinalAction)]
    steering = [number for number in kinds if issubclass(number, SteerAction)]
    if len(longitudinal) > 1 or len(steering) > 1:
        raise ConfigError(
            f"control_input is {control_input!r}, two names of the same kind; {_EXPECTED}"
        )
    return (
        longitudinal[0] if longitudinal else SpeedAction,
        steering[0] if steering else SteeringAngleAction,
    )


_EXPECTED = (
    f"expected one of {', '.join(member.value for member in LongitudinalActionEnum)} and one of "
    f"{', '.join(member.value for member in SteerActionEnum)}, such as ['speed', 'steering_angle']"
)
