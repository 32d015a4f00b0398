"""The result of a race."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib.metadata import version
from typing import Annotated, Any, ClassVar

import numpy as np
import numpy.ma

from stkzoo._schema import (
    Count,
    Level,
    Matching,
    OneOf,
    Place,
    Positive,
    Seconds,
    Whole,
    Within,
)
from stkzoo.drivers.sandbox import BUBBLEWRAP, LANDLOCK, NONE
from stkzoo.race.document import Document
from stkzoo.race.json_values import json_value

#: Version of the JSON schema (``docs/schemas/race-result.schema.json``); grows when an older
#: reader would fail.
SCHEMA_VERSION = 1


@dataclass(frozen=True, slots=True)
class AgentFailure:
    """A failure of an agent.

    Attributes:
        step: number of environment steps before it; 0 is before the start.
        kind: ``"start"`` (it could not be loaded), ``"timeout"`` or ``"error"``.
        message: the error.
        trace: the traceback in the agent's code, or the last output of its process.
    """

    step: Count
    kind: Annotated[str, OneOf(("start", "timeout", "error"))]
    message: Annotated[str, Within(1)]
    trace: str = field(compare=False, default="")


@dataclass(frozen=True, slots=True)
class ActionTime:
    """Duration of an agent's decisions, from its observation to its answer [s].

    The race's own clock measures it. For an agent on a server, the network counts too.

    Attributes:
        mean: mean of the decisions.
        p99: 99th percentile.
        max: of the longest.
        total: of all, with those that failed; ``None`` in old results.
    """

    mean: Seconds
    p99: Seconds
    max: Seconds
    total: Seconds | None = None

    @classmethod
    def of(cls, seconds: Sequence[float], total: float) -> ActionTime | None:
        """The statistics of some durations; ``None`` if there are none.

        Args:
            seconds: of decisions that succeeded.
            total: of all.
        """
        if not seconds:
            return None
        p99 = float(np.percentile(seconds, 99))
        return cls(float(np.mean(seconds)), p99, max(seconds), total)


@dataclass(frozen=True, slots=True)
class AgentResult:
    """The result of one agent.

    Attributes:
        agent: its id in the environment.
        driver: the driver's name.
        source: the driver's source, as the user wrote it.
        status: ``"finished"``, ``"racing"`` (when the race was over) or ``"retired"``.
        start_position: its place on the grid, 1 is in front.
        rank: its place, 1 is first; agents that did not finish follow by distance.
        finish_time: race time at the finish [s]; ``None`` if it did not finish.
        laps: laps done.
        distance: along the track from the start line [m], at most the length of the race.
        reward: the sum over the race.
        rescues: how often its kart was put back on the road; ``None`` in old results.
        num_errors: number of failures.
        num_clipped: number of actions with a number outside its space, which was clipped.
        errors: the first failures.
        action_time: duration of its decisions; ``None`` for the game's AI.
    """

    agent: Annotated[str, Matching("kart_[0-9]+", "an agent's id such as kart_0")]
    driver: str
    source: str
    status: Annotated[str, OneOf(("finished", "racing", "retired"))]
    start_position: Place
    rank: Place
    finish_time: Positive | None
    laps: Count
    distance: float
    reward: float
    rescues: Count | None = None
    num_errors: Count = 0
    num_clipped: Count = 0
    errors: Annotated[tuple[AgentFailure, ...], Within(0, 20)] = ()
    action_time: ActionTime | None = field(compare=False, default=None)


def versions_now() -> dict[str, str]:
    """Versions of the installed software."""
    return dict(_versions())


@cache
def _versions() -> dict[str, str]:
    packages = {"stkzoo": "stkzoo", "pystk2": "PySuperTuxKart2", "numpy": "numpy"}
    found = {name: version(package) for name, package in packages.items()}
    return {**found, "python": platform.python_version()}


def shared_protections(
    results: Iterable[RaceResult],
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The sandboxes of some races, and what was withheld in all races with agents from files."""
    foreign = [result for result in results if result.sandbox is not None]
    sandboxes = sorted({str(result.sandbox) for result in foreign})
    active = [set(result.protections) for result in foreign]
    return tuple(sandboxes), tuple(sorted(set.intersection(*active))) if active else ()


@dataclass(frozen=True, slots=True)
class RaceResult(Document):
    """The result of a race.

    Attributes:
        status: ``"finished"`` (all karts that were still driving), ``"awaited_finished"`` (all
            of ``wait_for``), ``"karts_finished"``, ``"max_steps_after_first"``, ``"max_steps"``,
            ``"time_limit"`` (of the runner), ``"abandoned"`` (no driver is left and none has
            finished), ``"interrupted"``, or a listener's reason to stop.
        track: its name.
        reverse: whether it was driven in the other direction.
        laps: laps to drive.
        difficulty: level of the game's AI, 0 to 3.
        seed: seed of the environment's reset; the same seed gives the same race.
        race_length: laps times the lap's length [m].
        steps: number of environment steps.
        race_time: game time of these steps [s].
        agents: one entry per agent, best rank first.
        versions: of the software.
        wall_time: real duration [s]; ignored when results are compared.
        sandbox: of agents from files that ran here: ``"bubblewrap"``, ``"landlock"`` or
            ``"none"``; ``None`` without such agents, and in old results. Ignored likewise.
        protections: what the sandbox withheld, and what the race limited for each agent from files
            (:func:`stkzoo.drivers.sandbox.protections`). Ignored likewise.
        time_budget: time that each agent could spend on its decisions [s]; ``None`` for no limit.
            Ignored likewise.
    """

    kind: ClassVar[str] = "race-result"
    version: ClassVar[int] = SCHEMA_VERSION
    origin: ClassVar[str] = "a file from `stkzoo race --output`"

    status: Annotated[str, Within(1)]
    track: str
    reverse: bool
    laps: Whole
    difficulty: Level
    seed: Count
    race_length: Positive
    steps: Count
    race_time: Seconds
    agents: Annotated[tuple[AgentResult, ...], Within(1, 256)]
    versions: dict[str, str] = field(compare=False, default_factory=versions_now)
    wall_time: Seconds = field(compare=False, default=0.0)
    sandbox: Annotated[str, OneOf((BUBBLEWRAP, LANDLOCK, NONE))] | None = field(
        compare=False, default=None
    )
    protections: tuple[str, ...] = field(compare=False, default=())
    time_budget: Seconds | None = field(compare=False, default=None)

    @property
    def is_finished(self) -> bool:
        """Whether all agents have finished."""
        return all(agent.finish_time is not None for agent in self.agents)

    @property
    def has_errors(self) -> bool:
        """Whether an agent failed."""
        return any(agent.num_errors for agent in self.agents)

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON values, with this class's field names and a ``schema_version``."""
        values = {"type": self.kind, "schema_version": self.version, **asdict(self)}
        return dict(json_value(values))
