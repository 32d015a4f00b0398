"""Agents in a race, independent of where their code runs.

The runner sends observations to all agents before it waits for the first decision. Agents in other
processes and on other machines therefore decide in parallel. Each agent gets the ``full`` view of
its kart and returns the game's action (:func:`~stkzoo.mdp.spaces.kart_observation_space`,
:func:`~stkzoo.mdp.spaces.kart_action_space`). The driver's view and wrappers run where its code
runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from gymnasium import spaces


@dataclass(frozen=True, slots=True)
class DriverLimits:
    """Resource limits of a driver.

    Attributes:
        action_timeout: time limit of one decision [s]; ``None`` for no limit.
        start_timeout: time limit of the start [s].
        memory: memory limit of the driver's processes [MB]; ``None`` for no limit.
        sandbox: whether the driver runs in a sandbox: ``"auto"``, ``"on"`` or ``"off"``
            (:func:`stkzoo.drivers.sandbox.sandbox_kind`).
    """

    action_timeout: float | None = 10.0
    start_timeout: float = 60.0
    memory: int | None = 4096
    sandbox: str = "auto"


@dataclass(slots=True)
class ThinkingClock:
    """Total decision time of a driver in one race, across restarts of the driver.

    Attributes:
        budget: time limit for all decisions together [s]; ``None`` for no limit.
        used: time used so far [s].
    """

    budget: float | None = None
    used: float = 0.0

    @property
    def is_over(self) -> bool:
        """Whether the budget is exhausted."""
        return self.budget is not None and self.used >= self.budget

    def limit(self, action_timeout: float | None) -> float | None:
        """Returns the time limit of the next decision [s].

        Args:
            action_timeout: time limit of one decision [s]; ``None`` for no limit.

        Returns:
            The smaller of ``action_timeout`` and the remaining budget, which counts as at least
                1 ms; ``None`` if neither is limited.
        """
        if self.budget is None:
            return action_timeout
        left = max(self.budget - self.used, 1e-3)
        return left if action_timeout is None else min(left, action_timeout)


@dataclass(frozen=True, slots=True)
class DriverRequest:
    """Arguments with which the runner starts a driver.

    Attributes:
        agent: id of the agent, such as ``"kart_0"``.
        observation_space: space of the observations that the instance gets.
        action_space: space of the actions that the instance returns.
        seed: seed of the driver's random numbers.
        limits: resource limits of the driver.
        output_label: prefix of each line that an agent in its own process prints; if empty, the
            output is not shown.
        clock: limits the total time of all decisions; the runner updates it.
        cores: processor cores on which an agent in its own process runs; empty for all.
        env: environment of the race, for drivers that come with stkzoo and plan with copies of the
            race; ``None`` if the race does not provide it. Other drivers must not use it.
    """

    agent: str
    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]
    seed: int
    limits: DriverLimits = field(default_factory=DriverLimits)
    output_label: str = ""
    clock: ThinkingClock = field(default_factory=ThinkingClock)
    cores: tuple[int, ...] = ()
    env: object | None = None


@dataclass(frozen=True, slots=True)
class Decision:
    """A driver's action for one observation.

    Attributes:
        action: an element of the request's action space; the runner checks it.
        seconds: time from the observation to the reply [s]. The race measures it, so an agent
            cannot falsify it.
        is_clipped: whether a number was outside its space and was clipped, or a key was unknown.
    """

    action: Any
    seconds: float
    is_clipped: bool = False


class DriverInstance(Protocol):
    """One driver in one race.

    Each method except :meth:`close` raises :class:`~stkzoo.errors.AgentError` if the driver fails
    and :class:`~stkzoo.errors.AgentTimeout` if it is too slow. Each method returns in bounded time.
    If the driver continues after an error, the runner keeps an instance that :attr:`is_usable`, and
    otherwise closes it and starts a new one.
    """

    @property
    def is_usable(self) -> bool:
        """Whether the instance accepts observations after an error in :meth:`answer`."""

    def ready(self) -> str:
        """Waits until the driver is ready.

        Returns:
            The name that the driver declares; empty if it has none.
        """

    def ask(self, observation: Any) -> None:
        """Sends the observation to the driver without waiting for its decision."""

    def answer(self) -> Decision:
        """Waits for the decision on the observation of the last :meth:`ask`."""

    def close(self) -> None:
        """Stops the driver and releases all resources. It may be called twice and never raises."""


#: Starts a driver and returns before it is ready, so that all drivers start in parallel.
DriverStart = Callable[[DriverRequest], DriverInstance]
