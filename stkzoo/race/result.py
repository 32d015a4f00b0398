"""The result of a race."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from typing import Annotated, Any, ClassVar

import numpy as np
import numpy.ma
from msgspec import Meta

from stkzoo._schema import Count, Level, Place, Positive, Seconds, Whole, matching, one_of
from stkzoo.config import NORMAL, RACE_MODES
from stkzoo.drivers.sandbox import BUBBLEWRAP, LANDLOCK, NONE
from stkzoo.race.document import Document

#: Version of the JSON schema (``docs/schemas/race-result.schema.json``). It increases with each
#: change that breaks older readers.
SCHEMA_VERSION = 1


@dataclass(frozen=True, slots=True)
class AgentFailure:
    """A failure of an agent.

    Attributes:
        step: number of environment steps before the failure; 0 before the first step.
        kind: ``"start"`` (the agent could not be loaded), ``"timeout"`` or ``"error"``.
        message: error message.
        trace: traceback in the agent's code, or the last output of its process.
    """

    step: Count
    kind: Annotated[str, one_of("start", "timeout", "error")]
    message: Annotated[str, Meta(min_length=1)]
    trace: str = field(compare=False, default="")


@dataclass(frozen=True, slots=True)
class ActionTime:
    """Durations of an agent's decisions, from the observation to the action [s].

    The race measures them. For an agent on a server, they include the network.

    Attributes:
        mean: mean duration.
        p99: 99th percentile.
        max: longest duration.
        total: total duration, including failed decisions; ``None`` in old results.
    """

    mean: Seconds
    p99: Seconds
    max: Seconds
    total: Seconds | None = None

    @classmethod
    def of(cls, seconds: Sequence[float], total: float) -> ActionTime | None:
        """Returns the statistics of durations; ``None`` if there are none.

        Args:
            seconds: durations of successful decisions [s].
            total: total duration of all decisions [s].
        """
        if not seconds:
            return None
        p99 = float(np.percentile(seconds, 99))
        return cls(float(np.mean(seconds)), p99, max(seconds), total)


@dataclass(frozen=True, slots=True)
class AgentResult:
    """The result of one agent.

    Attributes:
        agent: id of the agent in the environment.
        driver: the driver's name.
        source: text from which the user selected the driver.
        status: ``"finished"``, ``"racing"`` (still racing at the end) or ``"retired"``.
        start_position: position on the grid, from 1 at the front.
        rank: final rank, from 1. Agents that did not finish follow by distance.
        finish_time: race time at the finish [s]; ``None`` if the agent did not finish.
        laps: completed laps.
        distance: distance along the track from the start line [m], at most the race length.
        reward: sum of rewards over the race.
        rescues: number of rescues of the kart; ``None`` in old results.
        num_errors: number of failures.
        num_clipped: number of actions with a clipped number or an unknown key.
        errors: the first 20 failures; texts of later ones may be shortened.
        action_time: durations of the decisions; ``None`` for the game's AI and for agents without
            a successful decision.
    """

    agent: Annotated[str, matching("kart_[0-9]+")]
    driver: str
    source: str
    status: Annotated[str, one_of("finished", "racing", "retired")]
    start_position: Place
    rank: Place
    finish_time: Positive | None
    laps: Count
    distance: float
    reward: float
    rescues: Count | None = None
    num_errors: Count = 0
    num_clipped: Count = 0
    errors: Annotated[tuple[AgentFailure, ...], Meta(max_length=20)] = ()
    action_time: ActionTime | None = field(compare=False, default=None)


def versions_now() -> dict[str, str]:
    """Returns the versions of the installed software and of the C library, by name."""
    packages = {"stkzoo": "stkzoo", "pystk2": "PySuperTuxKart2", "numpy": "numpy"}
    versions = {name: version(package) for name, package in packages.items()}
    # Without LIBM (stkzoo.engine.process), some races depend on it.
    libc = " ".join(platform.libc_ver()).strip() or platform.platform(terse=True)
    return {**versions, "python": platform.python_version(), "libc": libc}


def shared_protections(
    results: Iterable[RaceResult],
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Returns the sandboxes of races and the protections that all of them share.

    Races without agents from files are ignored.
    """
    foreign = [result for result in results if result.sandbox is not None]
    sandboxes = sorted({str(result.sandbox) for result in foreign})
    active = [set(result.protections) for result in foreign]
    return tuple(sandboxes), tuple(sorted(set.intersection(*active))) if active else ()


@dataclass(frozen=True, slots=True)
class RaceResult(Document):
    """The result of a race.

    Attributes:
        status: why the race ended: ``"finished"`` (all karts have finished or retired, and at least
            one has finished), ``"abandoned"`` (all karts have retired), ``"awaited_finished"`` (all
            drivers in ``wait_for`` have finished or retired), ``"karts_finished"``,
            ``"max_steps_after_first"``, ``"max_steps"``, ``"time_limit"`` (the default limit
            without ``max_steps``), ``"interrupted"``, or a listener's reason to stop.
        track: name of the track.
        reverse: whether the track was driven in reverse direction.
        laps: number of laps of the race.
        difficulty: skill of the game's AI and speed of all karts, 0 to 3.
        seed: seed of the environment's reset; the same seed gives the same race.
        race_length: number of laps times the lap length [m].
        steps: number of environment steps.
        race_time: game time of these steps [s]; the countdown is part of it, unlike in times
            after GO, such as a finish time.
        agents: one entry per agent, best rank first.
        versions: versions of the software. This attribute and those below do not affect ``==``.
        wall_time: real duration [s].
        sandbox: sandbox of the agents from files that ran on this machine: ``"bubblewrap"``,
            ``"landlock"`` or ``"none"``; ``None`` without such agents and in old results.
        protections: resources that the sandbox and the race protect from agents from files
            (:func:`stkzoo.drivers.sandbox.protections`).
        time_budget: limit of each agent's total decision time [s]; ``None`` for no limit.
        mode: mode of the race, one of :data:`stkzoo.config.RACE_MODES`. It affects ``==``.
    """

    type_name: ClassVar[str] = "race-result"
    version: ClassVar[int] = SCHEMA_VERSION
    origin: ClassVar[str] = "a file from `stkzoo race --output`"

    status: Annotated[str, Meta(min_length=1)]
    track: str
    reverse: bool
    laps: Whole
    difficulty: Level
    seed: Count
    race_length: Positive
    steps: Count
    race_time: Seconds
    agents: Annotated[tuple[AgentResult, ...], Meta(min_length=1, max_length=256)]
    versions: dict[str, str] = field(compare=False, default_factory=versions_now)
    wall_time: Seconds = field(compare=False, default=0.0)
    sandbox: Annotated[str, one_of(BUBBLEWRAP, LANDLOCK, NONE)] | None = field(
        compare=False, default=None
    )
    protections: tuple[str, ...] = field(compare=False, default=())
    time_budget: Seconds | None = field(compare=False, default=None)
    mode: Annotated[str, one_of(*RACE_MODES)] = NORMAL

    @property
    def is_finished(self) -> bool:
        """Whether all agents have finished."""
        return all(agent.finish_time is not None for agent in self.agents)

    @property
    def has_errors(self) -> bool:
        """Whether an agent failed."""
        return any(agent.num_errors for agent in self.agents)

    def to_dict(self) -> dict[str, Any]:
        """Returns the result as JSON values, with its ``type`` and ``schema_version``."""
        return {"type": self.type_name, "schema_version": self.version, **asdict(self)}
