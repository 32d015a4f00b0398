"""Agents whose code runs in the program itself."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from types import FrameType
from typing import Any

from gymnasium import spaces
from gymnasium.wrappers.utils import create_zero_array

from stkzoo.errors import AgentError, AgentTimeout
from stkzoo.race.agents.code import AgentCode
from stkzoo.race.agents.failures import agent_trace, in_words
from stkzoo.race.instances import Decision, DriverRequest
from stkzoo.views.actions import split
from stkzoo.views.agent_chain import AgentChain


class AgentRunner:
    """An agent with its view, its wrappers and its state, in any process.

    It takes observations and returns actions of the ``full`` view. The agent's wrappers get its
    observations and actions, but no rewards, infos or ends: these are 0, empty and ``False``.

    Args:
        code: the agent's code.
        agent: its id.
        observation_space: space of the observations that :meth:`act` gets.
        action_space: space of the actions that it returns.
        seed: seed of the agent's action space.

    Raises:
        Exception: any exception of the agent's code, here and in :meth:`act`.
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
            observation: of its kart in the ``full`` view.

        Raises:
            ActionError: the action is not in the agent's own action space.
        """
        with self._code.scope:
            seen = self._see(observation)
            try:
                action = self._decode(self._actor(seen))
            except BaseException:
                self._skip_step()
                raise
            self._is_begun = True
            return action

    def close(self) -> None:
        """Closes the agent's wrappers."""
        with self._code.scope:
            self._chain.close()

    def _see(self, observation: Any) -> Any:
        """The observation in the agent's view, by its wrappers' ``reset`` or pending ``step``."""
        if not self._is_begun:
            return self._chain.reset(observation, {}, seed=self._seed)[0]
        self._is_begun = False
        return self._chain.finish_step((observation, 0.0, False, False, {}))[0]

    def _decode(self, action: Any) -> Any:
        """The game's own action; checked again after wrappers of the agent's own."""
        checked = self._chain.read_action(action)
        if self._chain.is_pure:
            return self._chain.begin_step(checked)
        return split(self._base, self._chain.begin_base_step(checked))[0]

    def _skip_step(self) -> None:
        """Begins a step for an agent that failed, so that its wrappers keep their memory."""
        with suppress(Exception):
            self._chain.begin_step(create_zero_array(self._chain.action_space))
            self._is_begun = True


class InlineInstance:
    """A driver in the program itself: fast, but its failures can affect the whole program.

    A signal ends a call that is too late. This works only in the program's main thread, and
    between two Python instructions.

    Args:
        request: the runner's request.
        load: loads the driver's code; its resources last as long as the stack.
    """

    is_usable = True

    def __init__(self, request: DriverRequest, load: Callable[[ExitStack], AgentCode]) -> None:
        self._request, self._load = request, load
        self._resources = ExitStack()
        self._runner: AgentRunner | None = None
        self._observation: Any = None

    def ready(self) -> str:
        """Loads the driver's code."""
        request = self._request
        with self._guarded("start", request.limits.start_timeout):
            code = self._load(self._resources)
            self._runner = AgentRunner(
                code, request.agent, request.observation_space, request.action_space, request.seed
            )
            return self._runner.name

    @property
    def paths_used(self) -> int | None:
        """How many track segments the driver uses; ``None`` for all. Known when ready."""
        return None if self._runner is None else self._runner.paths_used

    def ask(self, observation: Any) -> None:
        """Keeps the observation; the driver runs in :meth:`answer`."""
        self._observation = observation

    def answer(self) -> Decision:
        """Runs the driver."""
        agent = self._request.agent
        if self._runner is None:
            raise AgentError(f"{agent} was asked before it was ready", agent)
        begin = time.perf_counter()
        with self._guarded("action", self._request.limits.action_timeout):
            action = self._runner.act(self._observation)
        return Decision(action, time.perf_counter() - begin)

    def close(self) -> None:
        """Closes the driver's wrappers and removes its unpacked files."""
        runner, self._runner = self._runner, None
        with suppress(Exception):
            if runner is not None:
                runner.close()
        self._resources.close()

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
            raise AgentError(in_words(error), agent, agent_trace(error)) from error


class _TooLate(BaseException):
    """Ends a call; an agent's ``except Exception`` does not catch it."""


@contextmanager
def _time_limit(seconds: float | None) -> Iterator[None]:
    """Raises :class:`_TooLate` in its body after some time, where signals are available."""
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
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)
