"""Wrappers that change actions: continuous parts only, discrete steps, or a single number."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo._checks import check_whole, shortened
from stkzoo.errors import ConfigError
from stkzoo.views.bases import ActionFormWrapper, CompiledWrapper, dict_space

if TYPE_CHECKING:
    from stkzoo.views.plan import ViewPlan


class OnlyContinuousActionsWrapper(ActionFormWrapper, CompiledWrapper):
    """Keeps the continuous parts of an action; all buttons stay released.

    If the observation includes the game AI's ``action``, that action loses its buttons too.

    Args:
        env: an environment with the actions of the ``full`` view.

    Attributes:
        discrete_actions: space of the dropped parts.

    Raises:
        ConfigError: the environment's actions have no continuous part, or a part is neither a
            ``Box`` nor ``Discrete``.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        space = dict_space(env.action_space, "actions", "OnlyContinuousActionsWrapper")
        parts = copy.deepcopy(space.spaces)
        self._boxes: dict[str, spaces.Space[Any]] = {
            key: part for key, part in parts.items() if isinstance(part, spaces.Box)
        }
        if not self._boxes:
            raise ConfigError(
                f"OnlyContinuousActionsWrapper found only discrete actions ({', '.join(parts)}); "
                "leave out DiscreteActionsWrapper."
            )
        rest = {key: part for key, part in parts.items() if key not in self._boxes}
        for key, part in rest.items():
            if not isinstance(part, spaces.Discrete):
                raise ConfigError(
                    f"OnlyContinuousActionsWrapper cannot release {key!r}: {shortened(part)}. "
                    "Put it inside the wrappers that flatten, not around them."
                )
        self.discrete_actions = spaces.Dict(rest)
        self._change_action_space(spaces.Dict(self._boxes))

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if plan.has_action or "" in plan.leaves:
            return False
        plan.leaves = {key: plan.leaves[key] for key in self._boxes}
        return True

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Returns the action with all buttons set to 0."""
        return {**action, **dict.fromkeys(self.discrete_actions, 0)}

    def observed_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Returns the continuous parts of an action."""
        return {key: action[key] for key in self._boxes}


class Discretizer:
    """Maps numbers in an interval to the nearest of evenly spaced steps, including both ends.

    Attributes:
        space: ``Discrete(values)``, the steps.
        values: number of steps.
        min_value: number of step 0.
        max_value: number of the last step.

    Args:
        space: a ``Box`` with one entry; its bounds are the interval.
        values: number of steps, at least 2.

    Raises:
        ConfigError: there are fewer than two steps, or the space is not a bounded ``Box`` with one
            entry.

    Example:
        >>> steps = Discretizer(spaces.Box(-1, 1, (1,)), 5)
        >>> steps.discretize(0.4), steps.continuous(3)
        (3, 0.5)
    """

    def __init__(self, space: spaces.Space[Any], values: int) -> None:
        if not isinstance(space, spaces.Box) or space.shape != (1,) or not space.is_bounded():
            raise ConfigError(f"steps need a bounded Box of shape (1,), found {shortened(space)}")
        self.values = check_whole("number of steps", values, 2)
        self.min_value = float(space.low[0])
        self.max_value = float(space.high[0])
        self._width = self.max_value - self.min_value
        self.space = spaces.Discrete(self.values)

    def discretize(self, value: Any) -> int:
        """Returns the step nearest to a number (or to an array with one entry)."""
        share = (float(np.reshape(value, ())) - self.min_value) / self._width
        nearest = np.floor(share * (self.values - 1) + 0.5)
        return int(np.clip(nearest, 0, self.values - 1))

    def continuous(self, value: Any) -> Any:
        """Returns the number of a step as a ``float``, or of each step in an array as float64."""
        share = np.asarray(value, np.float64) / (self.values - 1)
        numbers = self._width * share + self.min_value
        return numbers if np.ndim(numbers) else float(numbers)


class DiscreteActionsWrapper(ActionFormWrapper, CompiledWrapper):
    """Discretizes ``acceleration`` and ``steer`` into evenly spaced steps.

    If the observation includes the game AI's ``action``, it is converted to the nearest steps.

    Args:
        env: an environment with the actions of the ``full`` view.
        acceleration_steps: number of acceleration values, from 0 to 1.
        steer_steps: number of steering values, from full left to full right; an odd number includes
            straight ahead.

    Raises:
        ConfigError: there are fewer than 2 steps, or the environment has other actions.
    """

    def __init__(
        self, env: gym.Env[Any, Any], *, acceleration_steps: int = 5, steer_steps: int = 7
    ) -> None:
        acceleration_steps = check_whole("acceleration_steps", acceleration_steps, 2)
        steer_steps = check_whole("steer_steps", steer_steps, 2)
        super().__init__(env)
        space = dict_space(env.action_space, "actions", "DiscreteActionsWrapper")
        self.d_acceleration = Discretizer(_required(space, "acceleration"), acceleration_steps)
        self.d_steer = Discretizer(_required(space, "steer"), steer_steps)
        self._discretizers = {"acceleration": self.d_acceleration, "steer": self.d_steer}
        steps = {key: spaces.Discrete(d.values) for key, d in self._discretizers.items()}
        self._change_action_space(spaces.Dict({**copy.deepcopy(space.spaces), **steps}))

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if plan.has_action or not {"acceleration", "steer"} <= plan.leaves.keys():
            return False
        steps = {}
        for key, discretizer in self._discretizers.items():
            table = discretizer.continuous(np.arange(discretizer.values)).astype(np.float32)
            column = plan.leaves[key][0][3]
            steps[key] = ((0.0, float(discretizer.values - 1), True, column, table),)
        plan.leaves = {**plan.leaves, **steps}
        return True

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Returns the action with steps ``(...)`` converted to numbers ``(..., 1)`` float32."""
        changed = dict(action)
        for key, discretizer in self._discretizers.items():
            numbers = discretizer.continuous(action[key])
            changed[key] = np.asarray(numbers, np.float32)[..., None]
        return changed

    def from_discrete(self, action: dict[str, Any]) -> dict[str, Any]:
        """Same as :meth:`action`; the name in pystk2-gymnasium."""
        return self.action(action)

    def to_discrete(self, action: dict[str, Any]) -> dict[str, Any]:
        """Returns one action with numbers converted to the nearest steps; undoes :meth:`action`."""
        steps = {key: each.discretize(action[key]) for key, each in self._discretizers.items()}
        return {**action, **steps}

    def observed_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Returns the action with numbers converted to steps."""
        return self.to_discrete(action)


def _required(space: spaces.Dict, key: str) -> spaces.Space[Any]:
    if key not in space.spaces:
        raise ConfigError(
            f"DiscreteActionsWrapper needs {key!r} among the actions {', '.join(space.spaces)}."
        )
    return space[key]


class FlattenMultiDiscreteActions(ActionFormWrapper, CompiledWrapper):
    """Numbers all combinations of a ``MultiDiscrete`` action.

    The first choice varies fastest: actions 0 and 1 differ in the first choice. If the observation
    includes the game AI's ``action``, it is converted to its number.

    Args:
        env: an environment whose action space is a ``MultiDiscrete`` vector.

    Raises:
        ConfigError: the environment's action space is not a ``MultiDiscrete`` vector.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        space = env.action_space
        if not isinstance(space, spaces.MultiDiscrete) or space.nvec.ndim != 1:
            raise ConfigError(
                "FlattenMultiDiscreteActions needs a MultiDiscrete action space. Put "
                f"DiscreteActionsWrapper and FlattenerWrapper inside it. Found {shortened(space)}"
            )
        self.nvec: npt.NDArray[np.int64] = space.nvec.astype(np.int64)
        self._start: npt.NDArray[np.int64] = space.start.astype(np.int64)
        self._strides = np.concatenate([[1], np.cumprod(self.nvec)[:-1]]).astype(np.int64)
        self._change_action_space(spaces.Discrete(int(np.prod(self.nvec))))

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if plan.has_action or not plan.has_choices:
            return False
        plan.number_choices(self.action(np.arange(np.prod(self.nvec))))
        return True

    def action(self, action: Any) -> npt.NDArray[np.int64]:
        """Returns the choices ``(..., m)`` int64 for a number ``(...)``."""
        numbers = np.asarray(action, np.int64)[..., None]
        choices = numbers // self._strides
        # The last choice is not reduced modulo its size, so numbers out of range stay invalid.
        choices[..., :-1] %= self.nvec[:-1]
        return np.asarray(choices + self._start)

    def observed_action(self, action: Any) -> Any:
        """Returns the number of the choices ``(m,)``."""
        return int((np.asarray(action) - self._start) @ self._strides)
