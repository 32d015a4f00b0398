"""A seat: one driver in one race, wherever the driver's code runs.

The runner first asks all seats and then collects their answers, so that drivers in other
processes or on other machines think at the same time. Every seat is given the ``full``
view of its kart and answers with the game's own action
(:func:`~stkzoo.mdp.spaces.kart_observation_space`, :func:`~stkzoo.mdp.spaces.kart_action_space`);
the driver's own view and wrappers are applied where its code runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from gymnasium import spaces

__all__ = ["Decision", "DriverInstance", "DriverLimits", "DriverRequest", "DriverStart"]


@dataclass(frozen=True, slots=True)
class DriverLimits:
    """What a driver may use.

    Attributes:
        action_timeout: for one decision [s]; ``None`` is as long as it likes.
        start_timeout: until it is ready to drive [s].
        memory: for its process [MB]; ``None`` is as much as there is.
    """

    action_timeout: float | None = 10.0
    start_timeout: float = 60.0
    memory: int | None = 4096


@dataclass(frozen=True, slots=True)
class DriverRequest:
    """What a seat is opened with.

    Attributes:
        agent: id of the agent, such as ``"kart_0"``.
        observation_space: of the observations that the seat will be given.
        action_space: of the actions that it has to give.
        seed: decides all that the driver leaves to chance.
        limits: what the driver may use.
    """

    agent: str
    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]
    seed: int
    limits: DriverLimits = field(default_factory=DriverLimits)


@dataclass(frozen=True, slots=True)
class Decision:
    """What a driver decided.

    Attributes:
        action: in the action space of the seat's request; the runner checks it.
        seconds: how long the driver thought, measured where its code runs.
    """

    action: Any
    seconds: float


class DriverInstance(Protocol):
    """One driver in one race.

    Each method but :meth:`close` raises :class:`~stkzoo.errors.AgentError` when the driver
    fails, :class:`~stkzoo.errors.AgentTimeout` when it is too slow, and returns in bounded
    time. After an error the seat is closed, and opened anew if the driver goes on, unless
    :attr:`is_usable`.
    """

    @property
    def is_usable(self) -> bool:
        """Whether the driver can be asked again after an error in :meth:`answer`."""
        ...

    def ready(self) -> str:
        """Waits until the driver can drive.

        Returns:
            The name that it gives itself; empty if it gives none.
        """
        ...

    def ask(self, observation: Any) -> None:
        """Lets the driver start to think, and returns at once."""
        ...

    def answer(self) -> Decision:
        """Waits for the decision on the last :meth:`ask`."""
        ...

    def close(self) -> None:
        """Lets the driver go and frees everything; may be called twice, never raises."""
        ...


#: Opens a seat. Returns before the driver is ready, so that all drivers start together.
DriverStart = Callable[[DriverRequest], DriverInstance]
