"""The environment that an agent's wrappers see in place of the race."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, SupportsFloat

import gymnasium as gym
from gymnasium import spaces

if TYPE_CHECKING:
    from stkzoo.wrappers.camera import Camera

__all__ = ["AgentStep", "MonoAgentEnv", "StepHandler"]

#: What a Gymnasium environment's ``step`` returns.
AgentStep = tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]


class StepHandler(Protocol):
    """Whoever turns one agent's action into the race's answer."""

    def step(self, action: Any) -> AgentStep:
        """The answer to the action, once the race has moved."""
        ...


class MonoAgentEnv(gym.Env[Any, Any]):
    """One agent's side of a race, as its wrappers wrap it.

    All agents move together, so this environment does nothing by itself: it hands out
    what :meth:`start` was given, and passes actions to a handler.

    Attributes:
        camera: the agent's camera, where the race can draw; set before the wrappers are made.

    Args:
        observation_space: the agent's observations before any wrapper.
        action_space: the agent's actions after all wrappers.
    """

    # No part of what is remembered (:mod:`stkzoo.wrappers.memory`): it belongs to the race.
    __slots__ = ("camera",)

    # Annotated afresh because gymnasium leaves the values' types open.
    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012
    render_mode = None

    def __init__(
        self, observation_space: spaces.Space[Any], action_space: spaces.Space[Any]
    ) -> None:
        self.observation_space = observation_space
        self.action_space = action_space
        self.camera: Camera | None = None
        self._handler: StepHandler | None = None
        self._first: tuple[Any, dict[str, Any]] | None = None

    def start(self, first: tuple[Any, dict[str, Any]] | None) -> None:
        """Sets what ``reset`` returns; ``None`` refuses resets from now on."""
        self._first = first

    def connect(self, handler: StepHandler | None) -> None:
        """Sets who answers ``step``; ``None`` refuses steps from now on."""
        self._handler = handler

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Returns the race's first observation and info; seeds ``np_random``."""
        super().reset(seed=seed, options=options)
        if self._first is None:
            raise RuntimeError(
                "a wrapper called reset in the middle of a race; one agent's wrapper cannot "
                "restart the race of all. End the agent's episode (truncated) instead."
            )
        observation, info = self._first
        return observation, dict(info)

    def step(self, action: Any) -> AgentStep:
        """Waits for the race to move and returns this agent's part."""
        if self._handler is None:
            raise RuntimeError(
                "a wrapper called step outside its own step (in reset, perhaps); one agent's "
                "wrapper cannot move the race of all."
            )
        return self._handler.step(action)
