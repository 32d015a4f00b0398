"""A wrapper's ``step`` in two halves, and the environment that an agent's wrappers see.

A race needs the base actions of all agents before it moves, and only then has results.
A wrapper with a ``step`` of its own does both in one call. That call runs in a small
thread, which stops at the environment's ``step`` until the results are there.
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


class AgentSide:
    """One agent's side of a race, in place of an environment that moves by itself.

    All agents move together, so it hands out what :meth:`start` was given, and passes actions
    to a step under way.
    """

    _handler: SplitStep | None = None
    _first: tuple[Any, dict[str, Any]] | None = None

    def start(self, first: tuple[Any, dict[str, Any]] | None) -> None:
        """Sets what ``reset`` returns; ``None`` refuses resets from now on."""
        self._first = first

    def connect(self, handler: SplitStep | None) -> None:
        """Sets what answers ``step``; ``None`` refuses steps from now on."""
        self._handler = handler

    def step(self, action: Any) -> AgentStep:
        """Waits for the race to move and returns this agent's part."""
        if self._handler is None:
            raise RuntimeError(
                "a wrapper called step outside its own step (in reset, perhaps); one agent's "
                "wrapper cannot move the race of all."
            )
        return self._handler.step(action)

    def _begun(self) -> tuple[Any, dict[str, Any]]:
        if self._first is None:
            raise RuntimeError(
                "a wrapper called reset in the middle of a race; one agent's wrapper cannot "
                "restart the race of all. End the agent's episode (truncated) instead."
            )
        observation, info = self._first
        return observation, dict(info)


class MonoAgentEnv(AgentSide, gym.Env[Any, Any]):
    """One agent's side of a race, as its wrappers wrap it.

    Attributes:
        camera: the agent's camera, where the race can draw; set before the wrappers are made.

    Args:
        observation_space: the agent's observations before any wrapper.
        action_space: the agent's actions after all wrappers.
    """

    # No part of what is remembered (``WrapperMemory``): it belongs to the race.
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

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Returns the race's first observation and info; seeds ``np_random``."""
        super().reset(seed=seed, options=options)
        return self._begun()


class CompiledPart(AgentSide, gym.Wrapper[Any, Any, Any, Any]):
    """One agent's side of a race, where the kernel does the work of the wrappers inside.

    Wrappers around it still see those inside; only ``reset`` and ``step`` go past them.
    """

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Returns the race's first observation and info; seeds ``np_random``."""
        gym.Env.reset(self.unwrapped, seed=seed, options=options)
        return self._begun()


class _Abandoned(BaseException):
    """Ends a parked thread; no wrapper's ``except Exception`` stops it."""


class SplitStep:
    """One call of a wrapper's ``step``, in two halves.

    Args:
        step: the outermost wrapper's ``step``, which must call this object's :meth:`step`
            once.
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
            Exception: what the wrapper raised.
        """
        self._thread.start()
        kind, value = self._answers.get()
        if kind == "action":
            return value
        self._thread.join()
        if kind == "error":
            raise value
        raise RuntimeError(
            "a wrapper's step returned without a call of its environment's step; the race "
            "moves at every step, so every wrapper must pass an action on."
        )

    def finish(self, result: AgentStep) -> AgentStep:
        """Runs the rest of ``step`` with the environment's answer; returns what it returns.

        Raises:
            Exception: what the wrapper raised.
        """
        self._results.put(result)
        kind, value = self._answers.get()
        self._thread.join()
        if kind == "error":
            raise value
        answer: AgentStep = value
        return answer

    def abandon(self) -> None:
        """Ends the call where it waits, if it does."""
        self._results.put(None)

    def step(self, action: Any) -> AgentStep:
        """The environment's side of the call, in the thread."""
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

    def _run(self, step: Callable[[Any], AgentStep], action: Any) -> None:
        try:
            answer = "result", step(action)
        except BaseException as error:  # noqa: BLE001 (handed to the caller's thread)
            self._answers.put(("error", error))
        else:
            self._answers.put(answer)
