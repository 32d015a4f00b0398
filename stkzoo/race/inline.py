"""Seats of drivers whose code runs in the program itself."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from types import FrameType
from typing import Any

from stkzoo.errors import AgentError, AgentTimeout, unknown_name
from stkzoo.race.agent_code import ActorMaker, AgentCode, load_agent
from stkzoo.race.agent_runner import AgentRunner
from stkzoo.race.files import AgentFiles
from stkzoo.race.seats import Decision, Seat, SeatRequest
from stkzoo.race.tracebacks import agent_trace, in_words
from stkzoo.views import VIEWS

__all__ = ["ActorOpener", "InlineFilesOpener", "InlineSeat"]


@dataclass(frozen=True, slots=True)
class ActorOpener:
    """Opens seats of a driver that is a Python function.

    Attributes:
        make_actor: makes its actor for one race.
        view: name of the view in which it sees and acts.
    """

    make_actor: ActorMaker
    view: str = "full"

    def __call__(self, request: SeatRequest) -> Seat:
        """Opens a seat."""
        if self.view not in VIEWS:
            raise unknown_name("view", self.view, VIEWS)
        code = AgentCode(VIEWS[self.view], self.make_actor)
        return InlineSeat(request, lambda _: code)


@dataclass(frozen=True, slots=True)
class InlineFilesOpener:
    """Opens seats of an agent from files, without a process of its own.

    Attributes:
        files: the agent's files.
        adapter: as for :func:`~stkzoo.race.agent_code.load_agent`.
    """

    files: AgentFiles
    adapter: str | None = None

    def __call__(self, request: SeatRequest) -> Seat:
        """Opens a seat."""
        return InlineSeat(request, lambda life: load_agent(self.files.place(life), self.adapter))


class InlineSeat:
    """A driver in the program itself: quick, but what it breaks is broken for all.

    A call that is too late is ended by a signal, which works in the program's main thread
    and between two lines of Python only.

    Args:
        request: what the runner asks for.
        load: loads the driver's code; what it needs lasts as long as the stack.
    """

    is_usable = True

    def __init__(self, request: SeatRequest, load: Callable[[ExitStack], AgentCode]) -> None:
        self._request, self._load = request, load
        self._life = ExitStack()
        self._runner: AgentRunner | None = None
        self._observation: Any = None

    def ready(self) -> str:
        """Loads the driver's code."""
        request = self._request
        with self._failures(), _time_limit(request.limits.start_timeout, request.agent, "start"):
            code = self._load(self._life)
            self._runner = AgentRunner(
                code, request.agent, request.observation_space, request.action_space, request.seed
            )
            return self._runner.name

    @property
    def paths_used(self) -> int | None:
        """How many track segments the driver looks at; ``None`` is all. Known when ready."""
        return None if self._runner is None else self._runner.paths_used

    def ask(self, observation: Any) -> None:
        """Keeps the observation; the driver thinks in :meth:`answer`."""
        self._observation = observation

    def answer(self) -> Decision:
        """Runs the driver."""
        if self._runner is None:
            raise AgentError(
                f"{self._request.agent} was asked before it was ready", self._request.agent
            )
        begin = time.perf_counter()
        limit = self._request.limits.action_timeout
        with self._failures(), _time_limit(limit, self._request.agent, "action"):
            action = self._runner.act(self._observation)
        return Decision(action, time.perf_counter() - begin)

    def close(self) -> None:
        """Closes the driver's wrappers and removes what was unpacked for it."""
        runner, self._runner = self._runner, None
        with suppress(Exception):
            if runner is not None:
                runner.close()
        self._life.close()

    @contextmanager
    def _failures(self) -> Iterator[None]:
        """Turns whatever the driver's code raises into an :class:`AgentError`."""
        try:
            yield
        except AgentTimeout:
            raise
        except (Exception, SystemExit) as error:
            raise AgentError(in_words(error), self._request.agent, agent_trace(error)) from error


class _TooLate(BaseException):
    """Ends a call; no agent's ``except Exception`` stops it."""


@contextmanager
def _time_limit(seconds: float | None, agent: str, what: str) -> Iterator[None]:
    """Ends what runs inside after some time, where signals can."""
    is_possible = hasattr(signal, "setitimer") and (
        threading.current_thread() is threading.main_thread()
    )
    if seconds is None or not is_possible:
        yield
        return

    def end(_: int, __: FrameType | None) -> None:
        raise _TooLate

    previous = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    except _TooLate:
        raise AgentTimeout(f"its {what} took longer than {seconds:g} s", agent) from None
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)
