"""The drivers of one race, and what becomes of those that fail."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

from gymnasium import spaces
from gymnasium.wrappers.utils import create_zero_array

from stkzoo.errors import ActionError, AgentError, AgentTimeout
from stkzoo.race.agents.failures import in_words, printable
from stkzoo.race.drivers import Driver
from stkzoo.race.instances import DriverInstance, DriverRequest
from stkzoo.race.result import AgentFailure
from stkzoo.race.settings import RaceSettings

__all__ = ["DriverGroup", "GroupMember"]

_MAX_FAILURES_KEPT = 20


class DriverGroup:
    """All drivers of a race but the game's AI.

    Args:
        drivers: who drives, by agent.
        observation_spaces: of the ``full`` view, by agent.
        action_spaces: likewise.
        settings: how failures are dealt with, and the limits.
    """

    def __init__(
        self,
        drivers: Mapping[str, Driver],
        observation_spaces: Mapping[str, spaces.Space[Any]],
        action_spaces: Mapping[str, spaces.Space[Any]],
        settings: RaceSettings,
    ) -> None:
        self.members = {
            agent: GroupMember(
                driver,
                DriverRequest(
                    agent,
                    observation_spaces[agent],
                    action_spaces[agent],
                    settings.seed + number,
                    settings.limits,
                ),
                settings,
            )
            for number, (agent, driver) in enumerate(drivers.items())
            if not driver.is_game_ai
        }

    def get_ready(self) -> None:
        """Opens all seats, and waits until all drivers are ready or have failed.

        Raises:
            AgentError: a driver failed, and ``error_handling`` is ``"raise"``.
        """
        for member in self.members.values():
            member.open()
        for member in self.members.values():
            member.get_ready(0)

    def decide(self, observations: Mapping[str, Any], step: int) -> dict[str, Any]:
        """The actions of all drivers that are given an observation.

        All are asked before any answer is waited for.

        Raises:
            AgentError: a driver failed, and ``error_handling`` is ``"raise"``.
        """
        asked = [member for agent, member in self.members.items() if agent in observations]
        for member in asked:
            member.ask(observations[member.agent], step)
        return {member.agent: member.answer(step) for member in asked}

    def refuse(self, error: ActionError, step: int) -> Any:
        """Takes note of an agent's action that cannot be; what is done in its place.

        Raises:
            AgentError: ``error_handling`` is ``"raise"``.
        """
        return self.members[error.agent].refuse(error, step)

    def driving(self, agents: Sequence[str]) -> list[str]:
        """Those of some agents that drive, the game's AI among them."""
        return [a for a in agents if a not in self.members or not self.members[a].is_retired]

    def failures(self) -> dict[str, tuple[AgentFailure, ...]]:
        """What has gone wrong, by agent."""
        return {agent: tuple(member.failures) for agent, member in self.members.items()}

    def close(self) -> None:
        """Closes all seats."""
        for member in self.members.values():
            member.close()


class GroupMember:
    """A driver in one race, from seat to seat.

    Attributes:
        agent: id of the agent.
        name: the name to show.
        failures: what has gone wrong, the first of it.
        num_failures: how often something has.
        seconds: how long it thought about each action [s].
        is_retired: whether it has been taken out of the race.
    """

    def __init__(self, driver: Driver, request: DriverRequest, settings: RaceSettings) -> None:
        self.agent = request.agent
        self.name = driver.name
        self.failures: list[AgentFailure] = []
        self.num_failures = 0
        self.seconds: list[float] = []
        self.is_retired = False
        self._driver, self._request, self._settings = driver, request, settings
        self._seat: DriverInstance | None = None
        self._is_ready = self._is_asked = False
        self._restarts = 0
        self._chance = copy.deepcopy(request.action_space)
        self._chance.seed(request.seed)

    def open(self) -> None:
        """Opens the seat; the driver gets ready meanwhile."""
        self._is_ready = False
        try:
            assert self._driver.start is not None  # noqa: S101 - not the game's AI
            self._seat = self._driver.start(self._request)
        except Exception as error:  # noqa: BLE001 - told in get_ready()
            self._seat = _FailedSeat(self._as_agent_error(error))

    def get_ready(self, step: int) -> None:
        """Waits until the driver is ready; one that cannot be is retired."""
        if self.is_retired or self._is_ready:
            return
        try:
            assert self._seat is not None  # noqa: S101 - opened before
            name = self._seat.ready()
        except Exception as error:  # noqa: BLE001 - only its own race is over
            self._record(error, step, "start")
            self._retire()
            return
        self._is_ready = True
        self.name = self.name or _one_line(name) or self._default_name()

    def ask(self, observation: Any, step: int) -> None:
        """Hands the observation over."""
        self._is_asked = False
        self.get_ready(step)
        if self.is_retired or self._seat is None:
            return
        try:
            self._seat.ask(observation)
            self._is_asked = True
        except Exception as error:  # noqa: BLE001 - see answer()
            self._fail(error, step)

    def answer(self, step: int) -> Any:
        """The action: the driver's, or the one in its place."""
        if not self._is_asked or self._seat is None:
            return self._stand_in()
        try:
            decision = self._seat.answer()
        except Exception as error:  # noqa: BLE001 - an agent's failure is its own
            self._fail(error, step)
            return self._stand_in()
        self.seconds.append(decision.seconds)
        return decision.action

    def refuse(self, error: ActionError, step: int) -> Any:
        """Takes note of an action that cannot be; what is done in its place."""
        self._fail(error, step)
        return self._stand_in()

    def close(self) -> None:
        """Closes the seat."""
        if self._seat is not None:
            self._seat.close()
            self._seat = None

    def _fail(self, error: Exception, step: int) -> None:
        self._record(error, step, "timeout" if isinstance(error, AgentTimeout) else "error")
        handling = self._settings.error_handling
        assert self._seat is not None  # noqa: S101 - it has been asked
        if handling == "catch" and self._seat.is_usable:
            return
        if handling == "retire" or self._restarts >= self._settings.max_restarts:
            self._retire()
            return
        self._restarts += 1
        self.close()
        self.open()

    def _record(self, error: Exception, step: int, kind: str) -> None:
        """Keeps a failure, or raises it if that is what is asked for."""
        told = self._as_agent_error(error)
        if self._settings.error_handling == "raise":
            raise told from error
        self.num_failures += 1
        if len(self.failures) < _MAX_FAILURES_KEPT:
            what = printable(in_words(error))
            self.failures.append(AgentFailure(step, kind, what, told.trace))

    def _as_agent_error(self, error: Exception) -> AgentError:
        """The error with the driver's name in its text."""
        who = self.name or self._driver.source
        what = printable(in_words(error))
        kind = type(error) if isinstance(error, AgentError) else AgentError
        trace = printable(error.trace) if isinstance(error, AgentError) else ""
        return kind(f"driver {who!r} of {self.agent} failed: {what}", self.agent, trace)

    def _retire(self) -> None:
        self.is_retired = True
        self.name = self.name or self._default_name()
        self.close()

    def _default_name(self) -> str:
        source = PurePath(self._driver.source)
        name = source.stem if source.suffix in (".zip", ".py") else source.name
        return _one_line(name) or self.agent

    def _stand_in(self) -> Any:
        """What is done in the place of a driver that gave no action."""
        if self._settings.error_handling == "catch" and not self.is_retired:
            return self._chance.sample()
        return create_zero_array(self._request.action_space)


def _one_line(name: str) -> str:
    """An agent's own name, fit for a table."""
    return printable(name).replace("\n", " ").strip()


class _FailedSeat:
    """A seat that could not be opened."""

    is_usable = False

    def __init__(self, error: AgentError) -> None:
        self._error = error

    def ready(self) -> str:
        raise self._error

    def ask(self, _: Any) -> None:
        raise self._error

    def answer(self) -> Any:
        raise self._error

    def close(self) -> None:
        pass
