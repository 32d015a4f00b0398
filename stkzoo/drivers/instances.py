"""A driver instance: one driver in one race, wherever the driver's code runs.

The runner asks all instances before it waits for any, so that drivers in other processes and on
other machines decide at the same time. Every instance gets the ``full`` view of its kart and
returns the game's own action (:func:`~stkzoo.mdp.spaces.kart_observation_space`,
:func:`~stkzoo.mdp.spaces.kart_action_space`). The driver's own view and wrappers are applied where
its code runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from gymnasium import spaces


@dataclass(frozen=True, slots=True)
class DriverLimits:
    """The resources that a driver may use.

    Attributes:
        action_timeout: time for one decision [s]; ``None`` for no limit.
        start_timeout: time until it is ready to drive [s].
        memory: memory of its processes [MB]; ``None`` for no limit.
        sandbox: when it runs in a sandbox: ``"auto"``, ``"on"`` or ``"off"``
            (:func:`stkzoo.drivers.sandbox.sandbox_kind`).
    """

    action_timeout: float | None = 10.0
    start_timeout: float = 60.0
    memory: int | None = 4096
    sandbox: str = "auto"


@dataclass(slots=True)
class ThinkingClock:
    """The time that a driver has spent on its decisions in one race, across restarts.

    Attributes:
        budget: the time that it may spend [s]; ``None`` for no limit.
        used: the time that it has spent [s].
    """

    budget: float | None = None
    used: float = 0.0

    @property
    def is_over(self) -> bool:
        """Whether the budget is used up."""
        return self.budget is not None and self.used >= self.budget

    def limit(self, action_timeout: float | None) -> float | None:
        """The time for the next decision [s]: the shorter one of a time limit and what is left."""
        if self.budget is None:
            return action_timeout
        left = max(self.budget - self.used, 1e-3)
        return left if action_timeout is None else min(left, action_timeout)


@dataclass(frozen=True, slots=True)
class DriverRequest:
    """The arguments that a driver is started with.

    Attributes:
        agent: id of the agent, such as ``"kart_0"``.
        observation_space: space of the observations that the instance gets.
        action_space: space of the actions that it returns.
        seed: seed of the driver's random numbers.
        limits: the resources that the driver may use.
        output_label: shows what an agent in a process of its own prints, with this before each
            line; empty to show nothing.
        clock: limits the time for all decisions together; the runner stops it.
        cores: the cores that an agent in a process of its own runs on; empty for all.
    """

    agent: str
    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]
    seed: int
    limits: DriverLimits = field(default_factory=DriverLimits)
    output_label: str = ""
    clock: ThinkingClock = field(default_factory=ThinkingClock)
    cores: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Decision:
    """A driver's answer to one observation.

    Attributes:
        action: in the action space of the request; the runner checks it.
        seconds: how long the driver took, from the observation to the answer. The race measures
            it with its own clock; an agent cannot set it.
        is_clipped: whether a number was outside its ``Box`` and was clipped.
    """

    action: Any
    seconds: float
    is_clipped: bool = False


class DriverInstance(Protocol):
    """One driver in one race.

    Each method except :meth:`close` raises :class:`~stkzoo.errors.AgentError` when the driver
    fails and :class:`~stkzoo.errors.AgentTimeout` when it is too slow, and returns in bounded
    time. After an error, the runner closes the instance and starts a new one if the driver
    continues, unless :attr:`is_usable`.
    """

    @property
    def is_usable(self) -> bool:
        """Whether the driver can be asked again after an error in :meth:`answer`."""
        ...

    def ready(self) -> str:
        """Waits until the driver can drive.

        Returns:
            The name that the driver gives itself; empty if it has none.
        """
        ...

    def ask(self, observation: Any) -> None:
        """Hands over the observation and returns at once."""
        ...

    def answer(self) -> Decision:
        """Waits for the decision on the last :meth:`ask`."""
        ...

    def close(self) -> None:
        """Ends the driver and frees everything; may be called twice, never raises."""
        ...


#: Starts a driver. Returns before the driver is ready, so that all drivers start together.
DriverStart = Callable[[DriverRequest], DriverInstance]


def without_unused_paths(observation: Any, paths_used: int | None) -> Any:
    """The observation without the track segments that a driver does not use.

    Args:
        observation: of the ``full`` view, or encoded.
        paths_used: number of segments that the driver uses; ``None`` for all.
    """
    if paths_used is None or isinstance(observation, bytes):
        return observation
    return {
        key: value[:paths_used] if key.startswith("paths_") else value
        for key, value in observation.items()
    }
