"""A wrapper's ``step`` that waits half way while the race moves.

A race needs the base actions of all agents before it moves, and only then has results.
A wrapper with a ``step`` of its own does both in one call, so that call runs in a small
thread, which stops at the environment's ``step`` until the results are there.
"""

from __future__ import annotations

from collections.abc import Callable
from contextvars import copy_context
from queue import SimpleQueue
from threading import Thread
from typing import Any

from stkzoo.wrappers.mono_env import AgentStep

__all__ = ["ParkedStep"]


class _Abandoned(BaseException):
    """Ends a parked thread; no wrapper's ``except Exception`` stops it."""


class ParkedStep:
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
