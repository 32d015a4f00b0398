"""A wrapper's ``step`` in two halves, and the environment inside an agent's wrappers.

A race needs the base actions of all agents before it advances, and has results only afterwards. A
wrapper with its own ``step`` does both in one call. That call runs in a thread, which stops at the
environment's ``step`` until the results are available.
"""

from __future__ import annotations

from collections.abc import Callable
from contextvars import copy_context
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any, SupportsFloat

import gymnasium as gym
from gymnasium import spaces

if TYPE_CHECKING:
    from stkzoo.wrappers.camera import Camera

#: What a Gymnasium environment's ``step`` returns.
AgentStep = tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]


class MonoAgentEnv(gym.Env[Any, Any]):
    """One agent's side of a race, as the innermost environment of its wrappers.

    Because all agents step together, ``reset`` returns a value that is set before, and ``step``
    passes the action on to the race's step.

    Attributes:
        camera: the agent's camera, if the race can render.
        handler: handler of ``step``; with ``None``, ``step`` raises an error.
        first: result of ``reset``; with ``None``, ``reset`` raises an error.

    Args:
        observation_space: observations before any wrapper.
        action_space: actions after all wrappers.
        camera: as above.
    """

    # A slot is not part of vars(), so ``WrapperMemory`` skips the camera, which is the race's.
    __slots__ = ("camera",)

    # Annotated here because Gymnasium does not annotate the values.
    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012
    render_mode = None
    handler: SplitStep | None = None
    first: tuple[Any, dict[str, Any]] | None = None

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        camera: Camera | None,
    ) -> None:
        self.observation_space, self.action_space = observation_space, action_space
        self.camera = camera

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Returns the race's first observation and info; seeds ``np_random``.

        Raises:
            RuntimeError: a wrapper called it outside its own ``reset``.
        """
        super().reset(seed=seed, options=options)
        if self.first is None:
            raise RuntimeError(
                "a wrapper called reset in the middle of a race; one agent's wrapper cannot "
                "restart the race of all. End the agent's episode (truncated) instead."
            )
        observation, info = self.first
        return observation, dict(info)

    def step(self, action: Any) -> AgentStep:
        """Waits until the race has advanced and returns this agent's part of the result.

        Raises:
            RuntimeError: a wrapper called it outside its own ``step``.
        """
        if self.handler is None:
            raise RuntimeError(
                "a wrapper called step outside its own step (in reset, perhaps); one agent's "
                "wrapper cannot move the race of all."
            )
        return self.handler.step(action)


class _Abandoned(BaseException):
    """Ends a waiting thread. As a ``BaseException`` it passes ``except Exception``."""


class SplitStep:
    """One call of a wrapper's ``step``, split into two halves.

    Args:
        step: ``step`` of the outermost wrapper, which must call :meth:`step` of this object once.
        action: the agent's action.
    """

    def __init__(self, step: Callable[[Any], AgentStep], action: Any) -> None:
        self._results: SimpleQueue[AgentStep | None] = SimpleQueue()
        self._answers: SimpleQueue[tuple[str, Any]] = SimpleQueue()
        self._was_called = False
        self._thread = Thread(
            target=copy_context().run, args=(self._run, step, action), daemon=True
        )

    def begin(self) -> Any:
        """Runs up to the environment's ``step``; returns the base action.

        Raises:
            Exception: any exception of the wrapper.
        """
        self._thread.start()
        return self._answer("action")

    def finish(self, result: AgentStep) -> AgentStep:
        """Runs the rest of ``step`` with the environment's result; returns the wrapper's result.

        Raises:
            Exception: any exception of the wrapper.
        """
        self._results.put(result)
        answer: AgentStep = self._answer("result")
        return answer

    def abandon(self) -> None:
        """Ends the call if it is waiting."""
        self._results.put(None)

    def step(self, action: Any) -> AgentStep:
        """The environment's ``step``, called in the thread.

        Raises:
            RuntimeError: the wrapper calls it twice.
        """
        if self._was_called:
            raise RuntimeError(
                "a wrapper called its environment's step twice in one step; all agents move "
                "together, so repeat actions for the whole race, not for one agent."
            )
        self._was_called = True
        self._answers.put(("action", action))
        result = self._results.get()
        if result is None:
            raise _Abandoned
        return result

    def _answer(self, expected: str) -> Any:
        """Waits for the wrapper's action or result."""
        outcome, value = self._answers.get()
        if outcome != "action":
            self._thread.join()
        if outcome == "error":
            raise value
        if outcome != expected:
            raise RuntimeError(
                "a wrapper's step returned without a call of its environment's step; the race "
                "moves at every step, so every wrapper must pass an action on."
            )
        return value

    def _run(self, step: Callable[[Any], AgentStep], action: Any) -> None:
        try:
            answer = "result", step(action)
        except BaseException as error:  # noqa: BLE001 (handed to the caller's thread)
            self._answers.put(("error", error))
        else:
            self._answers.put(answer)
