"""Both numbers of an action, and what the game is told."""

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

    The numbers come in this order whatever the order of the names, as in F1TENTH gymkhana.
    All methods are pure functions over arrays with any leading axes: one kart or many.

    Attributes:
        type: the names of both, in the order of the numbers.
        longitudinal: what the second number means.
        steering: what the first number means.
        space: ``(2,)`` float32, in physical units or in [-1, 1].
        params: the kart's limits.

    Args:
        control_input: one of ``"speed"`` [m/s] and ``"accl"`` [m/s^2], and one of
            ``"steering_angle"`` [rad] and ``"steering_speed"`` [rad/s]. One name alone goes
            with ``"speed"`` or ``"steering_angle"``.
        normalize: both numbers from -1 to 1 for the whole of their range, so that 0 is
            its middle, which is not standing still for ``"speed"``.
        params: the kart's limits, or a mapping of some of them; by default those of the
            game's default kart.

    Raises:
        ConfigError: an unknown name, or two of one kind.
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
        """Lowest and highest first number of ``space``."""
        return self.steering.lower_limit, self.steering.upper_limit

    @property
    def throttle_bounds(self) -> tuple[float, float]:
        """Lowest and highest second number of ``space``."""
        return self.longitudinal.lower_limit, self.longitudinal.upper_limit

    def new_controller(self, columns: Sequence[str]) -> CarController:
        """What does the same for many karts at once, in the kernel.

        Args:
            columns: of the game's controls.
        """
        own, limits = self.params, (self._low, self._high)
        return CarController(
            self.act,
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
        """What :meth:`act` is given at the start of a race, ``(*shape, 2)``: all zero.

        The angle of the wheels [rad], and the speed [m/s] that throttle and brake, which
        cannot give every acceleration, still owe to what was asked for.
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
        """What the game is told for an action.

        Args:
            action: ``(..., 2)`` in ``space``.
            speed: ``(...)`` forward speed, as observed in ``velocity[2]`` [m/s].
            max_steer_angle: ``(...)`` as observed [rad].
            memory: ``(..., 2)`` of :meth:`memory`, or from the call before.
            step_size: how long the action lasts [s].

        Returns:
            ``(..., 3)``: ``acceleration`` in [0, 1], ``steer`` in [-1, 1], ``brake`` 0 or 1;
            and the memory for the next call.
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
        """An action ``(..., 2)`` of ``space`` in physical units, float64."""
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
        """The action that asks for what a driver of the game's own controls did.

        Args:
            controls: ``(..., 3)``: ``acceleration``, ``steer`` and ``brake``.
            speed: ``(...)`` forward speed [m/s].
            max_steer_angle: ``(...)`` [rad].
            angle_before: ``(...)`` angle of the wheels before it [rad].
            step_size: how long it lasted [s].

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
        """The action for keys that are held, whatever the kart's speed.

        Full throttle asks for the most of the longitudinal number, the brake for the least, and
        neither for 0; full steering asks for the most of the steering number.

        Args:
            controls: ``(..., 3)``: ``acceleration``, ``steer`` and ``brake``.

        Returns:
            ``(..., 2)`` float32 in ``space``.
        """
        throttle, steer, brake = np.moveaxis(np.asarray(controls, np.float64), -1, 0)
        pushed = np.stack([steer, np.where(brake > 0, -1.0, throttle)], axis=-1)
        return self._in_space(np.where(pushed < 0, -pushed * self._low, pushed * self._high))

    def _in_space(self, action: FloatArray) -> FloatArray:
        """An action ``(..., 2)`` in physical units as one of ``space``, float32."""
        if self.normalize:
            action = (action - self._low) / (self._high - self._low) * 2.0 - 1.0
        inside: FloatArray = np.clip(action, self.space.low, self.space.high).astype(np.float32)
        return inside


def from_single_to_multi_action_space(
    single_action_space: spaces.Space[Any], num_agents: int
) -> spaces.Space[Any]:
    """The actions of several agents in one: ``(num_agents, 2)`` for a ``(2,)`` ``Box``.

    Raises:
        ConfigError: there is no agent.
    """
    return batch_space(single_action_space, check_whole("num_agents", num_agents, 1))


def _kinds(control_input: object) -> tuple[type[LongitudinalAction], type[SteerAction]]:
    """The classes of both numbers."""
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
            raise ConfigError(f"control_input is {control_input!r}, two of one kind; {_EXPECTED}")
        found[kind] = kind.from_string(name)
    return (
        found.get(LongitudinalActionEnum, SpeedAction),
        found.get(SteerActionEnum, SteeringAngleAction),
    )


_EXPECTED = (
    f"expected one of {', '.join(kind.value for kind in LongitudinalActionEnum)} and one of "
    f"{', '.join(kind.value for kind in SteerActionEnum)}, such as ['speed', 'steering_angle']"
)
