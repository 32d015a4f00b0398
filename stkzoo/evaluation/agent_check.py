"""A check of an agent before its submission to a tournament: errors, time and memory."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import PurePath
from typing import Any

from stkzoo._schema import plain_name
from stkzoo.drivers.driver import find_driver
from stkzoo.drivers.files import AgentFiles, find_files
from stkzoo.drivers.instances import Decision, DriverRequest
from stkzoo.drivers.isolated import IsolatedAgent
from stkzoo.errors import ConfigError
from stkzoo.race import ActionTime, run_race

#: Measurements of an agent by name, as in :class:`AgentReport`.
_Measured = dict[str, float | None]


@dataclass(frozen=True, slots=True)
class AgentReport:
    """The outcome of a check.

    Attributes:
        agent: the agent as the user wrote it.
        name: display name of the agent.
        passed: whether a tournament would accept the agent.
        reason: why the agent did not pass; empty if it passed.
        trace: traceback in the agent's code, and its last output; may be empty.
        steps: number of steps driven.
        distance: distance that the kart covered [m].
        num_clipped: number of actions that were clipped to the action space.
        load_time: time to start the agent's process and load the agent [s]; ``None`` if this
            failed.
        thinking_time: durations of the agent's decisions; ``None`` if it made none.
        memory: peak memory of the agent's process [MB]; ``None`` if the system does not report it.
    """

    agent: str
    name: str
    passed: bool
    reason: str
    trace: str = ""
    steps: int = 0
    distance: float = 0.0
    num_clipped: int = 0
    load_time: float | None = None
    thinking_time: ActionTime | None = None
    memory: float | None = None


def check_agent(
    source: str, *, track: str = "lighthouse", max_steps: int = 50, **settings: Any
) -> AgentReport:
    """Checks an agent in a race without other karts, in a separate process as in a tournament.

    Args:
        source: a folder, a zip, a Python file, or the name of a module.
        track: the track.
        max_steps: number of steps to drive.
        **settings: other fields of :class:`~stkzoo.race.RaceSettings`, such as ``seed`` and
            ``action_timeout``.

    Raises:
        ConfigError: the agent does not exist or comes with stkzoo, or an argument is invalid.
        AssetError: the game's data is missing.

    Example:
        >>> from stkzoo.evaluation import check_agent
        >>> report = check_agent("my_agent")  # doctest: +SKIP
        >>> report.passed  # doctest: +SKIP
        True
    """
    adapter = settings.get("adapter")
    source = str(source)  # it may be a Path
    path = source.rpartition("@:")[0] if "@:" in source else source
    try:
        files = find_files(path)
    except ConfigError as error:  # an existing path, such as a damaged zip
        return AgentReport(source, plain_name(PurePath(path).name), False, str(error))
    driver = find_driver(source, adapter=adapter)
    if files is None or not driver.is_from_files:
        raise ConfigError(
            f"{source!r} comes with stkzoo; name your own agent: a folder, a .zip or a .py file"
        )
    measured: _Measured = {}
    start = partial(_MeasuredAgent, files=files, adapter=adapter, measured=measured)
    settings |= {"track": track, "max_steps": max_steps, "error_handling": "retire"}
    result = run_race([replace(driver, start=start)], **settings)
    (row,) = result.agents
    reason = trace = ""
    if row.errors:
        failure = row.errors[0]
        when = "while loading" if failure.kind == "start" else f"at step {failure.step}"
        reason, trace = f"failed {when}: {failure.message}", failure.trace
    return AgentReport(
        source,
        row.driver,
        not reason,
        reason,
        trace,
        result.steps,
        row.distance,
        row.num_clipped,
        thinking_time=row.action_time,
        **measured,
    )


class _MeasuredAgent(IsolatedAgent):
    """An agent in a separate process, whose time to load [s] and memory [MB] are measured."""

    def __init__(
        self, request: DriverRequest, files: AgentFiles, adapter: str | None, measured: _Measured
    ) -> None:
        self._measured, self._begin = measured, time.perf_counter()
        super().__init__(request, files, adapter)

    def ready(self) -> str:
        """Waits until the agent is loaded and returns its name."""
        name = super().ready()
        self._measured["load_time"] = time.perf_counter() - self._begin
        self._measured["memory"] = self.peak_memory()
        return name

    def answer(self) -> Decision:
        """Waits for the agent's decision and returns it."""
        decision = super().answer()
        self._measured["memory"] = self.peak_memory()
        return decision
