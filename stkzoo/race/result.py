"""The result of a race."""

from __future__ import annotations

import math
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib.metadata import version
from typing import Any, ClassVar

import numpy as np
import numpy.ma

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

    step: int
    kind: str
    message: str
    trace: str = field(compare=False, default="")


@dataclass(frozen=True, slots=True)
class ActionTime:
    """Duration of an agent's decisions, where its code runs [s]."""

    mean: float
    p99: float
    max: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> ActionTime | None:
        """The statistics of some durations; ``None`` if there are none.

        Durations that are negative or not finite do not count: they may come from an agent.
        """
        valid = [second for second in seconds if 0 <= second < math.inf]
        if not valid:
            return None
        return cls(float(np.mean(valid)), float(np.percentile(valid, 99)), float(max(valid)))


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

    agent: str
    driver: str
    source: str
    status: str
    start_position: int
    rank: int
    finish_time: float | None
    laps: int
    distance: float
    reward: float
    rescues: int | None = None
    num_errors: int = 0
    num_clipped: int = 0
    errors: tuple[AgentFailure, ...] = ()
    action_time: ActionTime | None = field(compare=False, default=None)


def versions_now() -> dict[str, str]:
    """Versions of the installed software."""
    return dict(_versions())


@cache
def _versions() -> dict[str, str]:
    packages = {"stkzoo": "stkzoo", "pystk2": "PySuperTuxKart2", "numpy": "numpy"}
    found = {name: version(package) for name, package in packages.items()}
    return {**found, "python": platform.python_version()}


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
    """

    kind: ClassVar[str] = "race-result"
    version: ClassVar[int] = SCHEMA_VERSION
    origin: ClassVar[str] = "a file from `stkzoo race --output`"

    status: str
    track: str
    reverse: bool
    laps: int
    difficulty: int
    seed: int
    race_length: float
    steps: int
    race_time: float
    agents: tuple[AgentResult, ...]
    versions: dict[str, str] = field(compare=False, default_factory=versions_now)
    wall_time: float = field(compare=False, default=0.0)
    sandbox: str | None = field(compare=False, default=None)

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
