"""The base classes of wrappers that the machinery of views knows."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, SupportsFloat

import gymnasium as gym

__all__ = ["ActionObservationWrapper", "BatchedWrapper"]


class ActionObservationWrapper(gym.Wrapper[Any, Any, Any, Any]):
    """Changes the actions on their way in and the observations on their way out.

    Subclasses define :meth:`action` and :meth:`observation`, and set ``action_space``
    and ``observation_space`` where these differ from the wrapped environment's.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)

    def action(self, action: Any) -> Any:
        """The wrapped environment's form of an action of this wrapper."""
        raise NotImplementedError

    def observation(self, observation: Any) -> Any:
        """This wrapper's form of an observation of the wrapped environment."""
        raise NotImplementedError

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Resets the wrapped environment and changes the observation."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self.observation(observation), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Steps the wrapped environment with the changed action."""
        observation, reward, terminated, truncated, info = self.env.step(self.action(action))
        return self.observation(observation), reward, terminated, truncated, info


class BatchedWrapper(gym.utils.RecordConstructorArgs):
    """Marks a wrapper whose methods are pure functions over the last axes.

    A wrapper class that lists this class among its direct bases promises that

    - ``observation`` and ``action`` depend on nothing but their input and the
      constructor's arguments, and change neither;
    - both take any leading axes: ``(..., n)`` arrays where one agent has ``(n,)``, and
      ``(...)`` integer arrays where one agent has an ``int``;
    - the arguments are hashable and recorded with ``RecordConstructorArgs.__init__``;
    - ``reset`` and ``step`` are Gymnasium's own, and rewards are left alone.

    The promise is not inherited, because a subclass may break it: a subclass that keeps
    it lists this class again.
    """

    def batch_identity(self) -> Hashable:
        """What two wrappers have in common that do the same to the same spaces."""
        return type(self), tuple(sorted(self._saved_kwargs.items()))

    def keeps_batch_promise(self) -> bool:
        """Whether the object's own class lists :class:`BatchedWrapper`."""
        return BatchedWrapper in type(self).__bases__
