"""Acceleration and steering in steps."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.errors import ConfigError
from stkzoo.views.bases import ActionObservationWrapper, CompiledWrapper
from stkzoo.wrappers.arguments import (
    dict_space,
    observed_action,
    whole_number,
    with_observed_action,
)

if TYPE_CHECKING:
    from stkzoo.views.plan import ViewPlan

__all__ = ["DiscreteActionsWrapper", "Discretizer"]


class Discretizer:
    """Numbers from an interval as the nearest of evenly spaced steps, both ends included.

    Attributes:
        space: ``Discrete(values)``, the steps.
        values: number of steps.
        min_value: the number that step 0 stands for.
        max_value: the number that the last step stands for.

    Args:
        space: a ``Box`` of one entry; its bounds are the interval.
        values: number of steps, at least 2.

    Raises:
        ConfigError: fewer than two steps, or no bounded ``Box`` of one entry.

    Example:
        >>> steps = Discretizer(spaces.Box(-1, 1, (1,)), 5)
        >>> steps.discretize(0.4), steps.continuous(3)
        (3, 0.5)
    """

    def __init__(self, space: spaces.Space[Any], values: int) -> None:
        if not isinstance(space, spaces.Box) or space.shape != (1,) or not space.is_bounded():
            raise ConfigError(f"cannot make steps of {space!r}; expected a bounded Box of (1,).")
        self.values = whole_number("number of steps", values, 2)
        self.min_value = float(space.low[0])
        self.max_value = float(space.high[0])
        self.space = spaces.Discrete(self.values)

    def discretize(self, value: Any) -> int:
        """The nearest step to one number (or array of one entry)."""
        return int(self.nearest_steps(np.asarray(value, np.float64).reshape(())))

    def continuous(self, value: int) -> float:
        """The number that one step stands for."""
        return float(self.numbers(np.asarray(value, np.float64).reshape(())))

    def nearest_steps(self, numbers: npt.ArrayLike) -> npt.NDArray[np.int64]:
        """The nearest step to each number, an int64 array of the same shape."""
        share = (np.asarray(numbers, np.float64) - self.min_value) / self._width
        nearest = np.floor(share * (self.values - 1) + 0.5)
        return np.asarray(np.clip(nearest, 0, self.values - 1).astype(np.int64))

    def numbers(self, steps: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """The number that each step stands for, a float64 array of the same shape."""
        share = np.asarray(steps, np.float64) / (self.values - 1)
        return np.asarray(self._width * share + self.min_value)

    @property
    def _width(self) -> float:
        return self.max_value - self.min_value


class DiscreteActionsWrapper(ActionObservationWrapper, CompiledWrapper):
    """Makes ``acceleration`` and ``steer`` a choice among evenly spaced steps.

    The game AI's own ``action``, where the observation carries it, is given as the
    nearest steps.

    Args:
        env: an environment with the actions of the ``full`` view.
        acceleration_steps: number of accelerations, from 0 to 1.
        steer_steps: number of steering angles, from full left to full right; an odd
            number has straight ahead among them.

    Raises:
        ConfigError: fewer than 2 steps, or an environment without these actions.
    """

    def __init__(
        self, env: gym.Env[Any, Any], *, acceleration_steps: int = 5, steer_steps: int = 7
    ) -> None:
        acceleration_steps = whole_number("acceleration_steps", acceleration_steps, 2)
        steer_steps = whole_number("steer_steps", steer_steps, 2)
        gym.utils.RecordConstructorArgs.__init__(
            self, acceleration_steps=acceleration_steps, steer_steps=steer_steps
        )
        super().__init__(env)
        space = dict_space(env.action_space, "actions", "DiscreteActionsWrapper")
        self.d_acceleration = Discretizer(_required(space, "acceleration"), acceleration_steps)
        self.d_steer = Discretizer(_required(space, "steer"), steer_steps)
        self._discretizers = {"acceleration": self.d_acceleration, "steer": self.d_steer}
        steps = {key: spaces.Discrete(d.values) for key, d in self._discretizers.items()}
        self.action_space = spaces.Dict({**copy.deepcopy(space.spaces), **steps})
        self._has_action = observed_action(env.observation_space) is not None
        self.observation_space = with_observed_action(env.observation_space, self.action_space)

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if plan.has_action or not {"acceleration", "steer"} <= plan.leaves.keys():
            return False
        steps = {}
        for key, discretizer in self._discretizers.items():
            table = discretizer.numbers(np.arange(discretizer.values)).astype(np.float32)
            column = plan.leaves[key][0][3]
            steps[key] = ((0.0, float(discretizer.values - 1), True, column, table),)
        plan.leaves = {**plan.leaves, **steps}
        return True

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        """The action with numbers, ``(..., 1)`` float32, for steps ``(...)``."""
        changed = dict(action)
        for key, discretizer in self._discretizers.items():
            numbers = discretizer.numbers(action[key])
            changed[key] = numbers.astype(np.float32)[..., None]
        return changed

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """The observation with the AI's ``action`` in steps, if it has one."""
        if not self._has_action:
            return observation
        changed = dict(observation["action"])
        for key, discretizer in self._discretizers.items():
            steps = discretizer.nearest_steps(np.asarray(changed[key])[..., 0])
            changed[key] = steps if steps.ndim else int(steps)
        return {**observation, "action": changed}


def _required(space: spaces.Dict, key: str) -> spaces.Space[Any]:
    if key not in space.spaces:
        raise ConfigError(
            f"DiscreteActionsWrapper needs {key!r} among the actions {', '.join(space.spaces)}."
        )
    return space[key]
