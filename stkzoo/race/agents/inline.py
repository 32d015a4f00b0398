"""Agents whose code runs in the program itself."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from types import FrameType
from typing import Any

from gymnasium import spaces
from gymnasium.wrappers.utils import create_zero_array

from stkzoo.errors import AgentError, AgentTimeout, unknown_name
from stkzoo.race.agents.code import ActorMaker, AgentCode, load_agent
from stkzoo.race.agents.failures import agent_trace, in_words
from stkzoo.race.agents.files import AgentFiles
from stkzoo.race.instances import Decision, DriverInstance, DriverRequest
from stkzoo.views import VIEWS
from stkzoo.views.agent_chain import AgentChain
from stkzoo.views.batch import split

__all__ = ["ActorOpener", "AgentRunner", "InlineFilesOpener", "InlineInstance"]


class AgentRunner:
    """An agent with its view, its wrappers and its state, from ``full`` to ``full``.

    The wrappers see what the agent sees and does; rewards, infos and ends do not come
    along: they are 0, empty and ``False``.

    Args:
        code: the agent's code.
        agent: its id.
        observation_space: of the observations that :meth:`act` is given.
        action_space: of the actions that it returns.
        seed: decides what the agent draws from its action space.

    Raises:
        Exception: whatever the agent's code raises, here and in :meth:`act`.
    """

    def __init__(
        self,
        code: AgentCode,
        agent: str,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        seed: int,
    ) -> None:
        self._code, self._base = code, action_space
        self._is_begun = False
        with code.scope:
            self._chain = AgentChain(agent, observation_space, action_space, code.wrap)
            self._chain.action_space.seed(seed)
            view = self._chain.observation_space, self._chain.action_space
            self._actor = code.make_actor(*view, seed)
        self._seed = seed

    @property
    def name(self) -> str:
        """What the agent calls itself; empty if it does not say."""
        return self._code.name

    @property
    def paths_used(self) -> int | None:
        """How many track segments the agent looks at; ``None`` is all."""
        return self._chain.paths_used()

    def act(self, observation: Any) -> Any:
        """The agent's action, in the game's own form.

        Args:
            observation: what its kart sees in the ``full`` view.

        Raises:
            ActionError: the action is not in the agent's own action space.
        """
        with self._code.scope:
            seen = self._see(observation)
            try:
                action = self._decode(self._actor(seen))
            except BaseException:
                self._stand_in()
                raise
            self._is_begun = True
            return action

    def close(self) -> None:
        """Closes the agent's wrappers."""
        with self._code.scope:
            self._chain.close()

    def _see(self, observation: Any) -> Any:
        """The agent's view, by the wrappers' ``step`` if one was begun, else by ``reset``."""
        if not self._is_begun:
            return self._chain.reset(observation, {}, seed=self._seed)[0]
        self._is_begun = False
        return self._chain.finish_step((observation, 0.0, False, False, {}))[0]

    def _decode(self, action: Any) -> Any:
        """The game's own action; checked again behind wrappers that are the agent's own."""
        checked = self._chain.read_action(action)
        if self._chain.is_batched:
            return self._chain.begin_step(checked)
        return split(self._base, self._chain.begin_base_step(checked))[0]

    def _stand_in(self) -> None:
        """Begins a step for an agent that failed, so that its wrappers keep their memory."""
        with suppress(Exception):
            self._chain.begin_step(create_zero_array(self._chain.action_space))
            self._is_begun = True


@dataclass(frozen=True, slots=True)
class ActorOpener:
    """Opens seats of a driver that is a Python function.

    Attributes:
        make_actor: makes its actor for one race.
        view: name of the view in which it sees and acts.
    """

    make_actor: ActorMaker
    view: str = "full"

    def __call__(self, request: DriverRequest) -> DriverInstance:
        """Opens a seat."""
        if self.view not in VIEWS:
            raise unknown_name("view", self.view, VIEWS)
        code = AgentCode(VIEWS[self.view], self.make_actor)
        return InlineInstance(request, lambda _: code)


@dataclass(frozen=True, slots=True)
class InlineFilesOpener:
    """Opens seats of an agent from files, without a process of its own.

    Attributes:
        files: the agent's files.
        adapter: as for :func:`~stkzoo.race.agents.code.load_agent`.
    """

    files: AgentFiles
    adapter: str | None = None

    def __call__(self, request: DriverRequest) -> DriverInstance:
        """Opens a seat."""
        return InlineInstance(
            request, lambda life: load_agent(self.files.place(life), self.adapter)
        )


class InlineInstance:
    """A driver in the program itself: quick, but what it breaks is broken for all.

    A call that is too late is ended by a signal, which works in the program's main thread
    and between two lines of Python only.

    Args:
        request: what the runner asks for.
        load: loads the driver's code; what it needs lasts as long as the stack.
    """

    is_usable = True

    def __init__(self, request: DriverRequest, load: Callable[[ExitStack], AgentCode]) -> None:
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
