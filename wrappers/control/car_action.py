"""An action of two numbers in physical units, and its conversion to the game's controls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from stkzoo.errors import ConfigError, check_flag, check_whole
from stkzoo.kernel import CarController
from stkzoo.wrappers.control.kart import PEDALS, CarParameters, Pedals
from stkzoo.wrappers.control.kinds import (
    LongitudinalAction,
    LongitudinalActionEnum,
    SpeedAction,
    SteerAction,
    SteerActionEnum,
    SteeringAngleAction,
)

FloatArray = npt.NDArray[np.floating[Any]]


class CarAction:
    """An action of two numbers, ``[steering, longitudinal]``, in physical units.

    The numbers always have this order, whatever the order of the names, as in F1TENTH gymkhana. All
    methods are pure functions over arrays with any leading axes.

    Attributes:
        type: names of both numbers, in their order.
        longitudinal: meaning of the second number.
        steering: meaning of the first number.
        space: ``(2,)`` float32, in physical units or in [-1, 1].
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
        low, high = zip(self.steer_bounds, self.throttle_bounds, strict=True)
        self.space = spaces.Box(np.array(low, np.float32), np.array(high, np.float32))
        self._pedals = Pedals()

    @property
    def steer_bounds(self) -> tuple[float, float]:
        """Lower and upper bound of the first number in ``space``."""
        return self.steering.lower_limit, self.steering.upper_limit

    @property
    def throttle_bounds(self) -> tuple[float, float]:
        """Lower and upper bound of the second number in ``space``."""
        return self.longitudinal.lower_limit, self.longitudinal.upper_limit

    def new_controller(self, columns: Sequence[str]) -> CarController:
        """Returns the compiled form of :meth:`act`, ``stkzoo/kernel/car_controller.c``.

        Args:
            columns: names of the game's controls.
        """
        own, limits = self.params, (self._low, self._high)
        return CarController(
            (
                self.longitudinal.is_fed_back,
                self.steering.type == "steering_angle",
                self.normalize,
            ),
            (
                *(float(limit[number]) for number in (0, 1) for limit in limits),
                *(own.v_min, own.v_max, own.sv_max, own.speed_gain, own.T_steer),
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
            given = self._pedals.effect(throttle, brake, speed, step_size)
            owed = np.clip((wanted - given) * step_size, -2.0, 2.0)
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
    is_list = isinstance(names, Sequence) and all(isinstance(name, str) for name in names)
    if not is_list or not 1 <= len(names) <= 2:  # type: ignore[arg-type]
        raise ConfigError(f"control_input is {control_input!r}, {_EXPECTED}")
    found: dict[type, Any] = {}
    for name in names:  # type: ignore[attr-defined]
        kind = LongitudinalActionEnum if LongitudinalActionEnum.is_valid(name) else SteerActionEnum
        if not kind.is_valid(name):
            raise ConfigError(f"control_input has {name!r}, {_EXPECTED}")
        if kind in found:
            raise ConfigError(
                f"control_input is {control_input!r}, two names of the same kind; {_EXPECTED}"
            )
        found[kind] = kind.from_string(name)
    return (
        found.get(LongitudinalActionEnum, SpeedAction),
        found.get(SteerActionEnum, SteeringAngleAction),
    )


_EXPECTED = (
    f"expected one of {', '.join(kind.value for kind in LongitudinalActionEnum)} and one of "
    f"{', '.join(kind.value for kind in SteerActionEnum)}, such as ['speed', 'steering_angle']"
)
