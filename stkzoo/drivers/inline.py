"""Agents whose code runs in this process."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from types import FrameType
from typing import Any

from stkzoo._checks import shortened
from stkzoo.drivers.code import Actor, AgentCode
from stkzoo.drivers.failures import agent_trace, in_words
from stkzoo.drivers.instances import Decision, DriverRequest
from stkzoo.drivers.replies import pending
from stkzoo.errors import ActionError, AgentError, AgentTimeout
from stkzoo.views.agent_chain import AgentChain

#: Maximum length of an agent's value in an error [characters]; typical actions are shorter.
_MAX_VALUE = 1000


class InlineAgent:
    """An agent whose code, view and wrappers run in this process.

    It is fast, but a failure of the driver can affect the whole program. A signal interrupts a call
    that exceeds its time limit. This works only in the main thread, and only between two Python
    instructions.

    The agent's wrappers get its observations and actions, but not the race's rewards, infos and
    flags: these are 0, empty and ``False``.

    Args:
        request: the runner's request.
        load: loads the driver's code. Closing the stack releases its resources.
    """

    is_usable = True

    def __init__(self, request: DriverRequest, load: Callable[[ExitStack], AgentCode]) -> None:
        self._request, self._load = request, load
        self._resources = ExitStack()
        self._is_ready = self._is_begun = False
        self._observation: Any = None
        #: Number of track segments that the driver uses; ``None`` for all. Set by :meth:`ready`.
        self.paths_used: int | None = None

    def ready(self) -> str:
        """Loads the driver's code and returns the name that it declares."""
        request = self._request
        with self._guarded("start", request.limits.start_timeout):
            self._code = self._load(self._resources)
            with self._code.scope:
                self._chain = AgentChain(
                    request.agent,
                    request.observation_space,
                    request.action_space,
                    self._code.wrap,
                    is_strict=False,
                )
                self._chain.action_space.seed(request.seed)
                self._actor = self._make_actor()
            self.paths_used = self._chain.paths_used()
            self._is_ready = True
            return self._code.name

    def ask(self, observation: Any) -> None:
        """Stores the observation. The driver runs in :meth:`answer`."""
        self._observation = observation

    def answer(self) -> Decision:
        """Runs the driver and returns its decision."""
        agent = self._request.agent
        if not self._is_ready:
            raise AgentError(f"{agent} received an observation before it was ready", agent)
        pending.receive()  # so that the other drivers pay until now, and not for this driver's time
        begin, clipped = time.perf_counter(), self._chain.num_clipped
        limit = self._request.clock.limit(self._request.limits.action_timeout)
        try:
            with self._guarded("action", limit), self._code.scope:
                seen = self._see(self._observation)
                action = self._checked(self._actor(seen))
                self._is_begun = True
        except AgentError as error:
            error.seconds = time.perf_counter() - begin
            raise
        seconds = time.perf_counter() - begin
        return Decision(action, seconds, is_clipped=self._chain.num_clipped != clipped)

    def close(self) -> None:
        """Closes the driver's wrappers and copies of the race, and removes its unpacked files."""
        is_ready, self._is_ready = self._is_ready, False
        with suppress(Exception):
            if is_ready:
                with self._code.scope:
                    self._chain.close()
        self._resources.close()

    def _make_actor(self) -> Actor:
        request, make_race_actor = self._request, self._code.make_race_actor
        if make_race_actor is not None and request.env is not None:
            return self._resources.enter_context(make_race_actor(request.env, request.seed))
        return self._code.make_actor(
            self._chain.observation_space, self._chain.action_space, request.seed
        )

    def _see(self, observation: Any) -> Any:
        """Converts the observation by the wrappers' ``reset`` or their pending ``step``."""
        if not self._is_begun:
            return self._chain.reset(observation, {}, seed=self._request.seed)[0]
        self._is_begun = False
        return self._chain.finish_step((observation, 0.0, False, False, {}))[0]

    def _checked(self, action: Any) -> Any:
        """Converts an action to the game's action; an error shows the whole action and its space.

        Raises:
            AgentError: the action is invalid.
        """
        try:
            return self._chain.begin_step(self._chain.read_action(action))
        except ActionError as error:
            details = (
                f"the agent returned: {shortened(action, _MAX_VALUE)}\n"
                f"its action space:   {shortened(self._chain.action_space, _MAX_VALUE)}"
            )
            raise AgentError(in_words(error), self._request.agent, details) from error

    @contextmanager
    def _guarded(self, phase: str, limit: float | None) -> Iterator[None]:
        """Interrupts the driver's code at the time limit and converts its exceptions.

        Raises:
            AgentTimeout: the code exceeded the time limit.
            AgentError: the code raised an exception.
        """
        agent = self._request.agent
        try:
            with _time_limit(limit):
                yield
        except _TooLate:
            raise AgentTimeout(f"its {phase} took longer than {limit:g} s", agent) from None
        except (Exception, SystemExit) as error:
            trace = error.trace if isinstance(error, AgentError) else ""
            raise AgentError(in_words(error), agent, trace or agent_trace(error)) from error


class _TooLate(BaseException):
    """Interrupts a call. It is no ``Exception``, so an agent's ``except Exception`` misses it."""


@contextmanager
def _time_limit(seconds: float | None) -> Iterator[None]:
    """Raises :class:`_TooLate` in its body after a time limit, where signals are available."""
    is_possible = hasattr(signal, "setitimer") and (
        threading.current_thread() is threading.main_thread()
    )
    if seconds is None or seconds == math.inf or not is_possible:
        yield
        return

    def end(_: int, __: FrameType | None) -> None:
        raise _TooLate

    previous = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)
