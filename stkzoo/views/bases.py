"""Base classes of wrappers, and a check of the spaces that they wrap."""

from __future__ import annotations

import copy
import inspect
from typing import TYPE_CHECKING, Any, SupportsFloat

import gymnasium as gym
from gymnasium import spaces

from stkzoo._checks import shortened
from stkzoo._left_out import LeftOutNames
from stkzoo.errors import ConfigError

if TYPE_CHECKING:
    from typing_extensions import Self

    from stkzoo.views.plan import ViewPlan


class ActionObservationWrapper(gym.Wrapper[Any, Any, Any, Any]):
    """A wrapper that changes both actions and observations.

    Subclasses define :meth:`action` and :meth:`observation`. They set ``action_space`` and
    ``observation_space`` if these differ from those of the wrapped environment.
    """

    def action(self, action: Any) -> Any:
        """Converts an action of this wrapper to one of the wrapped environment."""
        raise NotImplementedError

    def observation(self, observation: Any) -> Any:
        """Converts an observation of the wrapped environment to one of this wrapper."""
        raise NotImplementedError

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Resets the wrapped environment and converts the observation."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self.observation(observation), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Converts the action, steps the wrapped environment and converts the observation."""
        observation, reward, terminated, truncated, info = self.env.step(self.action(action))
        return self.observation(observation), reward, terminated, truncated, info


class ActionFormWrapper(ActionObservationWrapper):
    """Base class of wrappers that change actions, including the AI's ``action`` in observations.

    Attributes:
        has_action: whether observations have the AI's ``action``.
    """

    def _change_action_space(self, space: spaces.Space[Any]) -> None:
        self.action_space = space
        seen = self.env.observation_space
        self.has_action = isinstance(seen, spaces.Dict) and "action" in seen.spaces
        if isinstance(seen, spaces.Dict) and self.has_action:
            parts = {**copy.deepcopy(seen.spaces), "action": copy.deepcopy(space)}
            self.observation_space = spaces.Dict(parts)

    def observed_action(self, action: Any) -> Any:
        """Converts an action of the wrapped environment to one of this wrapper."""
        raise NotImplementedError

    def observation(self, observation: Any) -> Any:
        """Returns the observation with the AI's ``action``, if it has one, converted."""
        if not self.has_action:
            return observation
        return {**observation, "action": self.observed_action(observation["action"])}


class RecordedWrapper(gym.utils.RecordConstructorArgs):
    """Records the constructor's arguments, so that ``spec`` can rebuild the wrapper.

    Subclasses need no code for it.
    """

    def __new__(cls, *arguments: Any, **keywords: Any) -> Self:
        """Makes the wrapper and records all arguments except the environment."""
        made = super().__new__(cls)
        _, env, *names = inspect.signature(cls.__init__).parameters
        recorded = {**dict(zip(names, arguments[1:], strict=False)), **keywords}
        recorded.pop(env, None)
        gym.utils.RecordConstructorArgs.__init__(made, _disable_deepcopy=True, **recorded)
        return made


class CompiledWrapper(RecordedWrapper, LeftOutNames):
    """Marks a wrapper that has a compiled form in the kernel.

    The wrapper's own methods run around environments of other libraries, and around wrappers that
    do not compile. They call the kernel's functions where these compute an entry.

    A wrapper class that lists this class among its direct bases guarantees that

    - ``observation`` and ``action`` depend only on their input and the constructor's arguments, and
      modify neither, unless ``has_memory`` is true;
    - :meth:`compile_into` describes them completely;
    - ``reset`` and ``step`` are Gymnasium's own, and rewards are unchanged.

    Subclasses do not inherit the guarantee, because they may break it. A subclass that keeps it
    lists this class again.

    Attributes:
        has_memory: whether the wrapper keeps state between steps.
    """

    has_memory = False

    def compile_into(self, plan: ViewPlan) -> bool:
        """Adds this wrapper to the plan of an agent's view.

        Args:
            plan: plan of the wrappers inside this one.

        Returns:
            Whether the plan can express the wrapper. If not, the plan is unchanged, and this
                wrapper and all wrappers around it run in Python.
        """
        raise NotImplementedError

    def keeps_promise(self) -> bool:
        """Whether the object's own class lists :class:`CompiledWrapper` as a base."""
        return CompiledWrapper in type(self).__bases__


def dict_space(space: spaces.Space[Any], what: str, wrapper: str) -> spaces.Dict:
    """Returns ``space`` if it is a ``Dict``.

    Args:
        space: the space to check.
        what: kind of values, such as ``"actions"``, for the message.
        wrapper: name of the wrapper, for the message.

    Raises:
        ConfigError: the space is not a ``Dict``.
    """
    if not isinstance(space, spaces.Dict):
        raise ConfigError(
            f"{wrapper} needs {what} in a Dict space. Put it inside the wrappers that flatten, not "
            f"around them. Found {shortened(space)}"
        )
    return space
