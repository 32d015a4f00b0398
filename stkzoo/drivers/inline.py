"""Agents whose code runs in the program itself."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from types import FrameType
from typing import Any

from gymnasium.wrappers.utils import create_zero_array

from stkzoo.drivers.code import AgentCode
from stkzoo.drivers.failures import agent_trace, in_words, value_in_words
from stkzoo.drivers.instances import Decision, DriverRequest
from stkzoo.errors import ActionError, AgentError, AgentTimeout
from stkzoo.views.agent_chain import AgentChain

#: Seconds until the alarm rings again: Python drops an exception that is raised in a destructor
#: or in a callback of its garbage collector.
_AGAIN = 0.5


class InlineInstance:
    """A driver with its view, its wrappers and its state, in the program itself.

    It is fast, but its failures can affect the whole program. A signal ends a call that is too
    late. This works only in the program's main thread, and between two Python instructions.

    The agent's wrappers get its observations and actions, but no rewards, infos or ends: these
    are 0, empty and ``False``.

    Args:
        request: the runner's request.
        load: loads the driver's code; its resources last as long as the stack.
    """

    is_usable = True

    def __init__(self, request: DriverRequest, load: Callable[[ExitStack], AgentCode]) -> None:
        self._request, self._load = request, load
        self._resources = ExitStack()
        self._is_ready = self._is_begun = False
        self._observation: Any = None
        #: How many track segments the driver uses; ``None`` for all. Known when ready.
        self.paths_used: int | None = None

    def ready(self) -> str:
        """Loads the driver's code."""
        request = self._request
        with self._guarded("start", request.limits.start_timeout):
            self._code = self._load(self._resources)
            with self._code.scope:
                kart_spaces = request.observation_space, request.action_space
                self._chain = AgentChain(
                    request.agent, *kart_spaces, self._code.wrap, is_strict=False
                )
                self._chain.action_space.seed(request.seed)
                view = self._chain.observation_space, self._chain.action_space
                self._actor = self._code.make_actor(*view, request.seed)
            self.paths_used = self._chain.paths_used()
            self._is_ready = True
            return self._code.name

    def ask(self, observation: Any) -> None:
        """Keeps the observation; the driver runs in :meth:`answer`."""
        self._observation = observation

    def answer(self) -> Decision:
        """Runs the driver."""
        agent = self._request.agent
        if not self._is_ready:
            raise AgentError(f"{agent} was asked before it was ready", agent)
        begin, clipped = time.perf_counter(), self._chain.num_clipped
        with self._guarded("action", self._request.limits.action_timeout), self._code.scope:
            seen = self._see(self._observation)
            try:
                action = self._checked(self._actor(seen))
            except BaseException:
                self._skip_step()
                raise
            self._is_begun = True
        seconds = time.perf_counter() - begin
        return Decision(action, seconds, is_clipped=self._chain.num_clipped != clipped)

    def close(self) -> None:
        """Closes the driver's wrappers and removes its unpacked files."""
        is_ready, self._is_ready = self._is_ready, False
        with suppress(Exception):
            if is_ready:
                with self._code.scope:
                    self._chain.close()
        self._resources.close()

    def _see(self, observation: Any) -> Any:
        """The observation in the agent's view, by its wrappers' ``reset`` or pending ``step``."""
        if not self._is_begun:
            return self._chain.reset(observation, {}, seed=self._request.seed)[0]
        self._is_begun = False
        return self._chain.finish_step((observation, 0.0, False, False, {}))[0]

    def _checked(self, action: Any) -> Any:
        """The game's own action; an invalid one is shown whole in the error."""
        try:
            return self._decode(action)
        except ActionError as error:
            details = (
                f"the agent returned: {value_in_words(action)}\n"
                f"its action space:   {value_in_words(self._chain.action_space)}"
            )
            raise AgentError(in_words(error), self._request.agent, details) from error

    def _decode(self, action: Any) -> Any:
        """The game's own action; checked again after wrappers of the agent's own."""
        checked = self._chain.read_action(action)
        if self._chain.is_pure:
            return self._chain.begin_step(checked)
        return self._chain.begin_base_step(checked)

    def _skip_step(self) -> None:
        """Begins a step for an agent that failed, so that its wrappers keep their memory."""
        with suppress(Exception):
            self._chain.begin_step(create_zero_array(self._chain.action_space))
            self._is_begun = True

    @contextmanager
    def _guarded(self, phase: str, limit: float | None) -> Iterator[None]:
        """Ends the driver's code when it is late; raises :class:`AgentError` when it fails."""
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
    """Ends a call; an agent's ``except Exception`` does not catch it."""


@contextmanager
def _time_limit(seconds: float | None) -> Iterator[None]:
    """Raises :class:`_TooLate` in its body after some time, where signals are available."""
    is_possible = hasattr(signal, "setitimer") and (
        threading.current_thread() is threading.main_thread()
    )
    if seconds is None or seconds == math.inf or not is_possible:
        yield
        return

    def end(_: int, __: FrameType | None) -> None:
        raise _TooLate

    previous = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds, _AGAIN)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)
