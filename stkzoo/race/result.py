"""The result of a race."""

from __future__ import annotations

import contextlib
import json
import math
import platform
import types
import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, is_dataclass
from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np

from stkzoo.errors import ConfigError
from stkzoo.race.agents.failures import printable

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
        """The statistics of some durations; ``None`` if there are none."""
        if not seconds:
            return None
        return cls(float(np.mean(seconds)), float(np.percentile(seconds, 99)), max(seconds))


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
    errors: tuple[AgentFailure, ...] = ()
    action_time: ActionTime | None = field(compare=False, default=None)


def versions_now() -> dict[str, str]:
    """Versions of the installed software."""
    packages = {"stkzoo": "stkzoo", "pystk2": "PySuperTuxKart2", "numpy": "numpy"}
    found = {name: version(package) for name, package in packages.items()}
    return {**found, "python": platform.python_version()}


@dataclass(frozen=True, slots=True)
class RaceResult:
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
    """

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
        return {"type": "race-result", "schema_version": SCHEMA_VERSION, **asdict(self)}

    def to_json(self) -> str:
        """:meth:`to_dict` as text."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> RaceResult:
        """Reads what :meth:`to_json` wrote.

        Raises:
            ConfigError: the text is something else, or of a later version.
        """
        with reading("the text is not a race result", "a file from `stkzoo race --output`"):
            result: RaceResult = typed(cls, read_document(text, "race-result", SCHEMA_VERSION))
            return result


@contextlib.contextmanager
def reading(problem: str, expected: str) -> Iterator[None]:
    """Explains the error of a block that reads a JSON document.

    Args:
        problem: what the error says first, such as ``"the text is not a race result"``.
        expected: what the text should have been.

    Raises:
        ConfigError: an entry is missing or has the wrong type, or the text is not JSON.
    """
    try:
        yield
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        raise ConfigError(
            f"{problem} ({type(error).__name__}: {error}); expected {expected}"
        ) from error


def json_with_rows(head: Mapping[str, Any], name: str, rows: Iterable[Mapping[str, Any]]) -> str:
    """A JSON object with one more entry, a list with an object on each line."""
    lines = ",\n    ".join(map(json.dumps, rows))
    text = json.dumps(head, indent=2, allow_nan=False)[:-2]
    return f'{text},\n  "{name}": [\n    {lines}\n  ]\n}}'


def read_json(text: str) -> Any:
    """The value of a JSON text. Unlike Python's own reader, it accepts only finite numbers.

    Raises:
        json.JSONDecodeError: the text is not JSON, too deep, or has numbers that are too long.
    """
    try:
        return json.loads(text, parse_constant=_finite, parse_float=_finite)
    except json.JSONDecodeError:
        raise
    except (ValueError, RecursionError) as error:
        raise json.JSONDecodeError(str(error)[:200], "", 0) from None


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text[:20]} is not a finite number")
    return number


def typed(hint: Any, value: Any, name: str = "the document") -> Any:
    """A JSON value as the type of a dataclass's field.

    Objects become dataclasses, without entries that are no fields: later versions may have
    others. Lists become tuples. Texts lose control codes, which a terminal would obey.

    Args:
        hint: the type: a dataclass, a tuple, a dict, a plain type, or one of these or ``None``.
        value: the value.
        name: what it is, for the error.

    Raises:
        TypeError: it has another type, or an entry is missing.
    """
    if isinstance(hint, types.UnionType):
        return None if value is None else typed(typing.get_args(hint)[0], value, name)
    kind: Any = typing.get_origin(hint) or hint
    parts = typing.get_args(hint)
    if isinstance(kind, type) and is_dataclass(kind) and type(value) is dict:
        hints = _hints(kind)
        return kind(**{key: typed(hints[key], value[key], key) for key in value if key in hints})
    if kind is tuple and type(value) is list:
        return tuple(typed(parts[0], entry, name) for entry in value)
    if kind in (dict, Mapping) and type(value) is dict:
        return {printable(key): typed(parts[1], value[key], key) for key in value}
    is_number = kind in (int, float) and type(value) is int
    if (is_number and abs(value) >= 2**63) or (type(value) is not kind and kind is not float):
        raise TypeError(f"{name} is {value!r:.60}, expected {kind.__name__}")
    return printable(value) if kind is str else value


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return typing.get_type_hints(kind)


def read_document(text: str, kind: str, version: int) -> dict[str, Any]:
    """The value of a JSON text of a type and version.

    Args:
        text: the content of a file.
        kind: the expected ``type``.
        version: the expected ``schema_version``.

    Raises:
        ConfigError: it is something else, or of another version.
        KeyError: it has no type or version.
        json.JSONDecodeError: see :func:`read_json`.
    """
    document: dict[str, Any] = read_json(text)
    check_document(document, kind, version)
    return document


def check_document(document: Mapping[str, Any], kind: str, version: int) -> None:
    """Checks the type and version of a document; raises as :func:`read_document`."""
    found = document["type"], document["schema_version"]
    if found != (kind, version):
        raise ConfigError(
            f"the file is a {found[0]} of version {found[1]}, expected a {kind} of version "
            f"{version}; another version of stkzoo wrote it"
        )
