"""The wrapper for actions in physical units."""

from __future__ import annotations

import copy
from collections.abc import Hashable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from stkzoo._checks import check_flag, check_name, check_number, check_type, shortened
from stkzoo.errors import ConfigError
from stkzoo.views.bases import ActionFormWrapper, CompiledWrapper, dict_space
from stkzoo.wrappers.control.car_action import CarAction
from stkzoo.wrappers.control.kart import CarParameters

if TYPE_CHECKING:
    from stkzoo.views.plan import ViewPlan

#: Buttons of the game that an action can have in addition to the two numbers.
BUTTONS = ("drift", "fire", "nitro", "rescue")

_PEDALS = ("acceleration", "steer", "brake")


class ControlWrapper(ActionFormWrapper, CompiledWrapper):
    """Replaces acceleration, steering and brake by ``control`` (2,), a :class:`CarAction`.

    The action is a dict of ``control`` and the chosen buttons (0 or 1); other buttons stay
    released. The observation is unchanged, but if it includes the game AI's ``action``, that is
    converted to the equivalent action.

    During a drift, the game maps steering differently and turns the wheels further than requested.

    Args:
        env: an environment with the game's actions, whose observation has ``velocity`` and
            ``max_steer_angle``. Put this wrapper inside wrappers that flatten.
        control_input: see :class:`CarAction`.
        normalize_act: see :class:`CarAction`.
        buttons: some of ``drift``, ``fire``, ``nitro`` and ``rescue``.
        params: see :class:`CarAction`.
        kart: kart model whose limits apply, as in ``AgentSpec.kart``; ``params`` takes precedence.
        step_size: game time of one step of the environment [s], unless the options of ``reset``
            have another. Views of races always use the race's.

    Raises:
        ConfigError: an argument is invalid, or the environment does not fit.
    """

    has_memory = True
    #: Whether to convert the observed ``action`` with :meth:`CarAction.held`, as for keys.
    reads_keys = False

    def __init__(
        self,
        env: gym.Env[Any, Any],
        *,
        control_input: str | Sequence[str] = ("speed", "steering_angle"),
        normalize_act: bool = False,
        buttons: Sequence[str] = (),
        params: CarParameters | Mapping[str, float] | None = None,
        kart: str = "",
        step_size: float = 0.1,
    ) -> None:
        limits = CarParameters.of(params, kart)
        self.car_action = CarAction(
            control_input, limits, check_flag("normalize_act", normalize_act)
        )
        self.buttons = _checked_buttons(buttons)
        self.step_size = check_number("step_size", step_size, unit="seconds")
        super().__init__(env)
        _check_actions(dict_space(env.action_space, "actions", "ControlWrapper"))
        _check_observations(dict_space(env.observation_space, "observations", "ControlWrapper"))
        pressed = {button: spaces.Discrete(2) for button in self.buttons}
        control = copy.deepcopy(self.car_action.space)
        self._change_action_space(spaces.Dict({"control": control, **pressed}))
        self._start(self.step_size)

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if plan.has_action or plan.car or plan.leaves.keys() != {*_PEDALS, *BUTTONS}:
            return False
        columns = [plan.leaves[key][0][3] for key in ("steer", "acceleration")]
        space = self.car_action.space
        control = tuple(
            (float(low), float(high), False, column, None)
            for low, high, column in zip(space.low, space.high, columns, strict=True)
        )
        plan.leaves = {"control": control, **{key: plan.leaves[key] for key in self.buttons}}
        plan.car = self
        return True

    def identity(self) -> Hashable:
        """Key that is equal for equivalent wrappers."""
        car = self.car_action
        return car.type, car.normalize, car.params, self.step_size

    def _start(self, step_size: float) -> None:
        self._step_size = step_size
        self._memory = self.car_action.memory()
        self._speed = self._max_angle = np.float64(0.0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Resets the environment and straightens the wheels."""
        step_size = (options or {}).get("step_size", self.step_size)
        self._start(check_number("step_size", step_size, unit="seconds"))
        return super().reset(seed=seed, options=options)

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Returns the game's action."""
        controls, self._memory = self.car_action.controls(
            np.asarray(action["control"]),
            self._speed,
            self._max_angle,
            self._memory,
            self._step_size,
        )
        return {
            **dict.fromkeys(BUTTONS, 0),
            "acceleration": controls[:1],
            "steer": controls[1:2],
            "brake": int(controls[2]),
            **{button: int(action[button]) for button in self.buttons},
        }

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Returns the observation, and records the speed for the controllers."""
        before = self._memory[0]
        speed, max_angle = self._speed, self._max_angle
        self._speed = np.float64(observation["velocity"][2])
        self._max_angle = np.float64(observation["max_steer_angle"][0])
        if not self.has_action:
            return observation
        done = observation["action"]
        controls = np.array([float(np.reshape(done[key], -1)[0]) for key in _PEDALS])
        if self.reads_keys:
            read = self.car_action.held(controls)
        else:
            read = self.car_action.read(controls, speed, max_angle, before, self._step_size)
        self._memory[0] = controls[1] * max_angle
        buttons = {button: int(done[button]) for button in self.buttons}
        return {**observation, "action": {"control": read, **buttons}}


def _checked_buttons(buttons: Any) -> tuple[str, ...]:
    check_type("buttons", buttons, Sequence, f"some of {', '.join(BUTTONS)}")
    for button in buttons:
        check_name("button", button, BUTTONS)
    return tuple(button for button in BUTTONS if button in buttons)


def _check_actions(space: spaces.Dict) -> None:
    keys = {*_PEDALS, *BUTTONS}
    if set(space.spaces) != keys or not isinstance(space["acceleration"], spaces.Box):
        raise ConfigError(
            f"ControlWrapper needs the game's own actions ({', '.join(sorted(keys))}). Put it "
            f"around full or simple, not around other actions. Found {shortened(space)}"
        )


def _check_observations(space: spaces.Dict) -> None:
    missing = [key for key in ("velocity", "max_steer_angle") if key not in space.spaces]
    if missing:
        raise ConfigError(
            f"ControlWrapper needs {' and '.join(missing)} in the observation, but found "
            f"{', '.join(space.spaces)}. Put it inside wrappers that drop or flatten them."
        )
