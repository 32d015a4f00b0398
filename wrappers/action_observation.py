"""The base class for wrappers that change both actions and observations."""

from __future__ import annotations

from typing import Any, SupportsFloat

import gymnasium as gym

__all__ = ["ActionObservationWrapper"]


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
