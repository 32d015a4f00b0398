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

from stkzoo._checks import check_flag, check_number, check_whole, unknown_name
from stkzoo.engine.snapshot import CONTROLS, HEADER_DTYPE, ITEM_DTYPE, KART_DTYPE, Snapshot
from stkzoo.errors import ConfigError
from stkzoo.kernel import CarController
from stkzoo.wrappers.control.kart import PEDALS, CarParameters, acceleration_of

FloatArray = npt.NDArray[np.floating[Any]]
#: Limits of a kart, as the constructors take them.
Parameters = CarParameters | Mapping[str, float] | None

#: Places in the state of a car, as in F1TENTH gymkhana.
_ANGLE, _SPEED = 2, 3


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

    ACCL = Accl = "accl"
    SPEED = Speed = "speed"


class SteerActionEnum(_ActionEnum):
    """Kinds of steering actions."""

    STEERING_ANGLE = Steering_Angle = "steering_angle"
    STEERING_SPEED = Steering_Speed = "steering_speed"


class NumberAction(ABC):
    """One number of an action.

    Attributes:
        type: meaning of the number, such as ``"speed"``.
        low: smallest value, in physical units.
        high: largest value, in physical units.
        normalize: whether that range is scaled to [-1, 1].
        scale_factor: physical units per unit of an action: 1, unless normalized.
        params: limits of the kart.
        timestep: duration of an action [s].
        lower_limit: smallest value of an action: ``low``, or -1 if normalized.
        upper_limit: largest value of an action: ``high``, or 1 if normalized.
        space: space of an action, ``()`` float32.

    Args:
        params: limits of the kart, or a mapping of some of them; by default, those of the game's
            default kart.
        normalize: whether to scale the range to [-1, 1].
        timestep: duration of an action [s]; by default, 0.1.

    Raises:
        ConfigError: an argument is invalid.
    """

    type: ClassVar[str]
    #: The field of :class:`CarParameters` with the largest value.
    _limit: ClassVar[str]

    def __init__(
        self,
        params: Parameters = None,
        normalize: bool = False,
        timestep: float | None = None,
    ) -> None:
        self.params = CarParameters.of(params)
        self.normalize = check_flag("normalize", normalize)
        timestep = 0.1 if timestep is None else timestep
        self.timestep = check_number("timestep", timestep, unit="seconds")
        self.high: float = getattr(self.params, self._limit)
        self.low: float = self.params.v_min if self._limit == "v_max" else -self.high
        self.scale_factor = (self.high - self.low) / 2.0 if self.normalize else 1.0
        self.lower_limit = -1.0 if self.normalize else self.low
        self.upper_limit = 1.0 if self.normalize else self.high
        self.space = spaces.Box(self.lower_limit, self.upper_limit, (), np.float32)

    @abstractmethod
    def act(self, action: Any, state: Any, params: Parameters = None) -> FloatArray:
        """Returns the motion that an action requests, ``(...)`` float64.

        Args:
            action: ``(...)`` in ``space``.
            state: ``(..., n)`` state of the car with at least four numbers, as in F1TENTH gymkhana:
                x and y, which are ignored, wheel angle [rad] and forward speed [m/s].
            params: limits of the kart, instead of those of the constructor.

        Returns:
            The acceleration [m/s^2] of a longitudinal action, or the turning speed of the wheels
                [rad/s] of a steering action, positive to the right.
        """

    @abstractmethod
    def read(self, reached: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """Returns the value, in physical units, that leads to a motion, ``(...)``.

        Args:
            reached: ``(...)`` acceleration [m/s^2] or wheel angle [rad] that is reached.
            before: ``(...)`` forward speed [m/s] or wheel angle [rad] before.
            step_size: duration of the action [s].
        """

    def _physical(self, action: Any) -> FloatArray:
        """Converts an action in ``space`` to physical units."""
        values = np.asarray(action, np.float64)
        return self.low + (values + 1.0) * self.scale_factor if self.normalize else values

    def _limits(self, params: Parameters) -> CarParameters:
        return self.params if params is None else CarParameters.of(params)


class LongitudinalAction(NumberAction):
    """A number that requests an acceleration."""


class SpeedAction(LongitudinalAction):
    """A target speed [m/s], reached and held by a proportional controller."""

    type, _limit = "speed", "v_max"

    def act(self, action: Any, state: Any, params: Parameters = None) -> FloatArray:
        """See :meth:`NumberAction.act`."""
        gain = _speed_gain(self._limits(params), self.timestep)
        accl: FloatArray = (self._physical(action) - np.asarray(state)[..., _SPEED]) * gain
        return accl

    def read(self, reached: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`NumberAction.read`."""
        target = before + reached / _speed_gain(self.params, step_size)
        return np.clip(target, self.low, self.high)


class AcclAction(LongitudinalAction):
    """An acceleration [m/s^2], within the limits of speed."""

    type, _limit = "accl", "a_max"

    def act(self, action: Any, state: Any, params: Parameters = None) -> FloatArray:
        """See :meth:`NumberAction.act`."""
        limits, speed = self._limits(params), np.asarray(state)[..., _SPEED]
        slowest = np.minimum((limits.v_min - speed) / self.timestep, 0.0)
        fastest = np.maximum((limits.v_max - speed) / self.timestep, 0.0)
        return np.clip(self._physical(action), slowest, fastest)

    def read(self, reached: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`NumberAction.read`."""
        del before, step_size
        return np.clip(reached, self.low, self.high)


class SteerAction(NumberAction):
    """A number that requests a turning speed of the wheels. Angles are positive to the right."""


class SteeringAngleAction(SteerAction):
    """A wheel angle [rad], reached as fast as ``sv_max`` and ``T_steer`` allow."""

    type, _limit = "steering_angle", "s_max"

    def act(self, action: Any, state: Any, params: Parameters = None) -> FloatArray:
        """See :meth:`NumberAction.act`."""
        limits, angle = self._limits(params), np.asarray(state)[..., _ANGLE]
        share = _wheels_share(limits, self.timestep)
        rate = (self._physical(action) - angle) / self.timestep * share
        within: FloatArray = np.clip(rate, -limits.sv_max, limits.sv_max)
        return within

    def read(self, reached: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`NumberAction.read`."""
        if self.params.T_steer > 0:
            reached = before + (reached - before) / _wheels_share(self.params, step_size)
        return np.clip(reached, self.low, self.high)


class SteeringSpeedAction(SteerAction):
    """Turning speed of the wheels [rad/s]; with 0 they keep their angle."""

    type, _limit = "steering_speed", "sv_max"

    def act(self, action: Any, state: Any, params: Parameters = None) -> FloatArray:
        """See :meth:`NumberAction.act`."""
        fastest = self._limits(params).sv_max
        rate, _ = np.broadcast_arrays(self._physical(action), np.asarray(state)[..., _ANGLE])
        within: FloatArray = np.clip(rate, -fastest, fastest)
        return within

    def read(self, reached: FloatArray, before: FloatArray, step_size: float) -> FloatArray:
        """See :meth:`NumberAction.read`."""
        return np.clip((reached - before) / step_size, self.low, self.high)


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
        normalize: whether both ranges are scaled to [-1, 1].
        params: limits of the kart.
        timestep: duration of an action [s].

    Args:
        control_mode: one of ``"speed"`` [m/s] and ``"accl"`` [m/s^2], and one of
            ``"steering_angle"`` [rad] and ``"steering_speed"`` [rad/s]. A single name is completed
            with ``"speed"`` or ``"steering_angle"``.
        params: limits of the kart, or a mapping of some of them; by default, those of the game's
            default kart.
        normalize: scale the range of both numbers to [-1, 1]. 0 is then the middle of the range,
            which for ``"speed"`` is not standstill.
        timestep: duration of an action [s]; by default, 0.1.

    Raises:
        ConfigError: a name is unknown, or both names are of one kind.
    """

    def __init__(
        self,
        control_mode: str | Sequence[str] = ("speed", "steering_angle"),
        params: Parameters = None,
        normalize: bool = False,
        timestep: float | None = None,
    ) -> None:
        longitudinal, steering = _kinds(control_mode)
        self.longitudinal: LongitudinalAction = longitudinal(params, normalize, timestep)
        self.steering: SteerAction = steering(params, normalize, timestep)
        numbers = self.steering, self.longitudinal
        self.type = self.steering.type, self.longitudinal.type
        self.params, self.normalize = self.steering.params, self.steering.normalize
        self.timestep = self.steering.timestep
        self._low = np.array([number.low for number in numbers], np.float32)
        self._high = np.array([number.high for number in numbers], np.float32)
        self.steer_bounds = self.steering.lower_limit, self.steering.upper_limit
        self.throttle_bounds = self.longitudinal.lower_limit, self.longitudinal.upper_limit
        low, high = zip(self.steer_bounds, self.throttle_bounds, strict=True)
        self.space = spaces.Box(np.array(low, np.float32), np.array(high, np.float32))

    def new_controller(self) -> CarController:
        """Returns the object that computes :meth:`controls` for several karts of a race."""
        kart, (steering, longitudinal) = self.params, self.type
        ranges = [float(limit[number]) for number in (0, 1) for limit in (self._low, self._high)]
        limits = kart.v_min, kart.v_max, kart.sv_max, kart.speed_gain, kart.T_steer
        return CarController(
            (longitudinal == "speed", steering == "steering_angle", self.normalize),
            (*ranges, *limits),
            PEDALS,
        )

    def act(
        self, action: Any, state: Any, params: Parameters = None
    ) -> tuple[FloatArray, FloatArray]:
        """Returns the motion that an action requests, as F1TENTH gymkhana's method of that name.

        :meth:`controls` converts an action for the game.

        Args:
            action: ``(..., 2)`` in ``space``.
            state: see :meth:`NumberAction.act`.
            params: limits of the kart, instead of those of the constructor.

        Returns:
            Acceleration [m/s^2] and turning speed of the wheels [rad/s], ``(...)`` float64.
        """
        steering, longitudinal = np.moveaxis(np.asarray(action), -1, 0)
        return (
            self.longitudinal.act(longitudinal, state, params),
            self.steering.act(steering, state, params),
        )

    def memory(self, shape: tuple[int, ...] = ()) -> FloatArray:
        """Returns the initial memory for :meth:`controls`, ``(*shape, 2)`` zeros.

        The memory holds the wheel angle [rad] and the remaining speed change [m/s]: throttle and
        brake cannot produce every acceleration, so the rest is carried over.
        """
        return np.zeros((*shape, 2))

    def controls(
        self,
        action: Any,
        speed: Any,
        max_steer_angle: Any,
        memory: FloatArray,
        step_size: float | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Converts an action to the game's controls, with ``stkzoo/kernel/car_controller.c``.

        Args:
            action: ``(..., 2)`` in ``space``.
            speed: ``(...)`` forward speed, as observed in ``velocity[2]`` [m/s].
            max_steer_angle: ``(...)`` as observed [rad].
            memory: ``(..., 2)`` from :meth:`memory` or from the previous call.
            step_size: duration of the action [s]; by default, ``timestep``.

        Returns:
            Controls ``(..., 3)`` float32: ``acceleration`` in [0, 1], ``steer`` in [-1, 1],
                ``brake`` 0 or 1; and the memory for the next call.
        """
        numbers = np.asarray(action, np.float32)
        karts = np.zeros(np.broadcast_shapes(numbers.shape[:-1], np.shape(speed)), KART_DTYPE)
        karts["velocity_lc"][..., 2], karts["max_steer_angle"] = speed, max_steer_angle
        controls = np.zeros((*karts.shape, len(CONTROLS)), np.float32)
        controls[..., 0], controls[..., 1] = numbers[..., 1], numbers[..., 0]
        states = np.zeros((*karts.shape, 3))
        states[..., :2], states[..., 2] = memory, step_size or self.timestep
        header, items = np.zeros((), HEADER_DTYPE), np.zeros(0, ITEM_DTYPE)
        data = Snapshot.of(header, karts.reshape(-1), items).data  # type: ignore[arg-type]
        rows = np.arange(karts.size)
        self.new_controller().drive(controls, rows, data, rows, states, rows)
        return controls[..., :3], states[..., :2]

    def read(
        self,
        controls: FloatArray,
        speed: FloatArray,
        max_steer_angle: FloatArray,
        angle_before: FloatArray,
        step_size: float | None = None,
    ) -> FloatArray:
        """Returns the action equivalent to controls of the game; the inverse of :meth:`controls`.

        Args:
            controls: ``(..., 3)``: ``acceleration``, ``steer`` and ``brake``.
            speed: ``(...)`` forward speed [m/s].
            max_steer_angle: ``(...)`` [rad].
            angle_before: ``(...)`` previous wheel angle [rad].
            step_size: duration of the controls [s]; by default, ``timestep``.

        Returns:
            ``(..., 2)`` float32 in ``space``.
        """
        step_size = step_size or self.timestep
        throttle, steer, brake = np.moveaxis(np.asarray(controls, np.float64), -1, 0)
        accl = acceleration_of(throttle, brake > 0, speed, step_size)
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
    single_agent_action_space: spaces.Space[Any], num_agents: int
) -> spaces.Space[Any]:
    """Returns the joint action space of several agents: ``(num_agents, 2)`` for a ``(2,)`` ``Box``.

    Args:
        single_agent_action_space: action space of one agent.
        num_agents: number of agents.

    Raises:
        ConfigError: ``num_agents`` is below 1.
    """
    return batch_space(single_agent_action_space, check_whole("num_agents", num_agents, 1))


def _speed_gain(limits: CarParameters, step_size: float) -> float:
    """Returns the speed controller's gain [1/s], reduced for long steps so that none overshoots."""
    return min(limits.speed_gain, 0.8 / step_size)


def _wheels_share(limits: CarParameters, step_size: float) -> float:
    """Returns the fraction of the remaining angle that the wheels cover in a step."""
    lag = limits.T_steer
    return 1.0 - math.exp(-step_size / lag) if lag > 0 else 1.0


def _kinds(control_mode: object) -> tuple[type[LongitudinalAction], type[SteerAction]]:
    """Returns the classes of both numbers."""
    names = [control_mode] if isinstance(control_mode, str) else control_mode
    if not isinstance(names, Sequence) or not 1 <= len(names) <= 2:
        raise ConfigError(f"the names of the action are {control_mode!r}, {_EXPECTED}")
    kinds: dict[Any, Any] = {LongitudinalAction: SpeedAction, SteerAction: SteeringAngleAction}
    named: dict[Any, Any] = {}
    for name in names:
        if not isinstance(name, str) or name not in _CLASSES:
            raise ConfigError(f"the action has the name {name!r}, {_EXPECTED}")
        named[_CLASSES[name].__base__] = _CLASSES[name]
    if len(named) < len(names):
        raise ConfigError(
            f"the action has two names of the same kind, {control_mode!r}; {_EXPECTED}"
        )
    kinds |= named
    return kinds[LongitudinalAction], kinds[SteerAction]


_EXPECTED = (
    f"expected one of {', '.join(member.value for member in LongitudinalActionEnum)} and one of "
    f"{', '.join(member.value for member in SteerActionEnum)}, such as ['speed', 'steering_angle']"
)
