"""Drivers in a race, and the handling of their failures."""

from __future__ import annotations

import copy
import logging
from dataclasses import replace
from typing import Any

from gymnasium.wrappers.utils import create_zero_array

from stkzoo._schema import plain_name
from stkzoo.drivers.driver import Driver
from stkzoo.drivers.failures import bounded, fitted, in_words, json_size, printable
from stkzoo.drivers.files import name_of_files
from stkzoo.drivers.instances import DriverInstance, DriverRequest, ThinkingClock
from stkzoo.errors import AgentError, AgentTimeout
from stkzoo.race.result import AgentFailure
from stkzoo.race.settings import RaceSettings

_MAX_FAILURES_KEPT = 20
#: Maximum length of a traceback including the last output [characters].
_MAX_TRACE = 8000
#: Size of the texts of all failures of an agent, and minimum size for each message [bytes of JSON].
#: Results and replays of races with 256 such agents can be read.
_MAX_TEXTS, _MIN_MESSAGE = 16 << 10, 300
_CLIPPED = (
    "an action of {} ({}) at step {} has a number outside its space, which is clipped, or an "
    "unknown key, which is ignored; from now on such actions are only counted"
)

logger = logging.getLogger(__name__)


class RacingDriver:
    """A driver in one race, across restarts of its instance.

    If the driver fails and ``error_handling`` is ``"raise"``, all methods except :meth:`close`
    raise :class:`~stkzoo.errors.AgentError`. The argument ``step`` of the methods is
    the number of environment steps so far.

    Args:
        driver: the driver; not the game's AI.
        request: arguments with which its instances are started.
        settings: settings of the race.

    Attributes:
        agent: id of the agent.
        name: display name.
        failures: the first 20 failures; texts of later ones may be shortened.
        num_failures: number of all failures.
        num_clipped: number of decisions with a clipped number or an unknown key.
        seconds: duration of each successful decision [s].
        clock: total time of all decisions.
        is_retired: whether the driver is out of the race.
    """

    def __init__(self, driver: Driver, request: DriverRequest, settings: RaceSettings) -> None:
        self.agent = request.agent
        self.name = plain_name(driver.name)
        self.failures: list[AgentFailure] = []
        self.num_failures = self.num_clipped = 0
        self._text_left = _MAX_TEXTS
        self.seconds: list[float] = []
        self.clock = ThinkingClock(settings.time_budget)
        self.is_retired = False
        self._driver, self._settings = driver, settings
        label = (
            f"{self.name or self._default_name()} ({self.agent})" if settings.show_output else ""
        )
        self._request = replace(request, output_label=label, clock=self.clock)
        self._instance: DriverInstance | None = None
        self._is_ready = self._is_asked = False
        self._restarts = 0
        self._random_actions = copy.deepcopy(request.action_space)
        self._random_actions.seed(request.seed)

    def start(self, step: int) -> None:
        """Starts the driver without waiting until it is ready, or retires it if that fails."""
        assert self._driver.start is not None  # noqa: S101 - not the game's AI
        self._is_ready = False
        try:
            self._instance = self._driver.start(self._request)
        except Exception as error:  # noqa: BLE001 - affects only this driver
            self._record(error, step, "start")
            self._retire()

    def get_ready(self, step: int) -> None:
        """Waits until the driver is ready, or retires it if the start fails."""
        if self.is_retired or self._is_ready:
            return
        try:
            name = self._started().ready()
        except Exception as error:  # noqa: BLE001 - affects only this driver
            self._record(error, step, "start")
            self._retire()
            return
        self._is_ready = True
        self.name = self.name or plain_name(name) or self._default_name()

    def ask(self, observation: Any, step: int) -> None:
        """Waits until the driver is ready, then sends the observation to it."""
        self._is_asked = False
        self.get_ready(step)
        if self.is_retired:
            return
        try:
            self._started().ask(observation)
            self._is_asked = True
        except Exception as error:  # noqa: BLE001 - see answer()
            self._handle(error, step)

    def answer(self, step: int) -> Any:
        """Returns the driver's action, or a replacement if the driver failed."""
        if not self._is_asked:
            return self._replacement()
        try:
            decision = self._started().answer()
        except Exception as error:  # noqa: BLE001 - affects only this driver
            return self.replace_action(error, step)
        self.seconds.append(decision.seconds)
        self.clock.used += decision.seconds
        if self.clock.is_over:
            self._end_for_time(step)
            return self._replacement()
        if decision.is_clipped:
            if not self.num_clipped:
                logger.warning("%s", _CLIPPED.format(self.name, self.agent, step))
            self.num_clipped += 1
        return decision.action

    def replace_action(self, error: Exception, step: int) -> Any:
        """Records the failure of a decision, or an invalid action, and returns a replacement."""
        self._handle(error, step)
        return self._replacement()

    def close(self) -> None:
        """Closes the driver's instance."""
        instance, self._instance = self._instance, None
        if instance is not None:
            instance.close()

    def _started(self) -> DriverInstance:
        assert self._instance is not None  # noqa: S101 - until it retires
        return self._instance

    def _handle(self, error: Exception, step: int) -> None:
        """Records a failure during the race, then keeps, restarts or retires the driver."""
        self.clock.used += error.seconds if isinstance(error, AgentError) else 0.0
        if self.clock.is_over:
            self._end_for_time(step)
            return
        self._record(error, step, "timeout" if isinstance(error, AgentTimeout) else "error")
        handling = self._settings.error_handling
        if handling == "catch" and self._started().is_usable:
            return
        if handling == "retire" or self._restarts >= self._settings.max_restarts:
            self._retire()
            return
        self._restarts += 1
        self.close()
        self.start(step)

    def _end_for_time(self, step: int) -> None:
        """Retires a driver that has exhausted its time budget, for all error handlings."""
        budget = f"its time budget of {self.clock.budget:g} s"
        problem = AgentTimeout(f"it has used up {budget} for decisions", self.agent)
        self._record(problem, step, "timeout")
        self._retire()

    def _record(self, error: Exception, step: int, failure_kind: str) -> None:
        """Stores a failure, or raises it if ``error_handling`` is ``"raise"``."""
        text = printable(in_words(error)) or "(no message)"
        trace = str(error.trace) if isinstance(error, AgentError) else ""
        trace = printable(bounded(trace, _MAX_TRACE))
        if self._settings.error_handling == "raise":
            who = self.name or self._driver.source
            error_type = type(error) if isinstance(error, AgentError) else AgentError
            message = f"driver {who!r} of {self.agent} failed: {text}"
            raise error_type(message, self.agent, trace) from error
        self.num_failures += 1
        if len(self.failures) < _MAX_FAILURES_KEPT:
            text = self._fitted(text, _MIN_MESSAGE)
            self.failures.append(AgentFailure(step, failure_kind, text, self._fitted(trace)))

    def _fitted(self, text: str, minimum: int = 0) -> str:
        """Shortens a text of a failure so that those of all failures have a bounded size."""
        text = fitted(text, max(self._text_left, minimum))
        self._text_left -= json_size(text)
        return text

    def _retire(self) -> None:
        self.is_retired = True
        self.name = self.name or self._default_name()
        self.close()

    def _default_name(self) -> str:
        return plain_name(name_of_files(self._driver.source)) or self.agent

    def _replacement(self) -> Any:
        """Returns the action that replaces a missing or invalid one."""
        if self._settings.error_handling == "catch" and not self.is_retired:
            return self._random_actions.sample()
        return create_zero_array(self._request.action_space)
