"""What the plans of all batches share: checks, JSON, and comparison with another plan."""

from __future__ import annotations

import json
import types
import typing
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from stkzoo.engine.assets import find_assets
from stkzoo.env.options import RaceOptions
from stkzoo.errors import ConfigError, unknown_name
from stkzoo.evaluation.batch.entrants import Entrant
from stkzoo.evaluation.batch.order import BatchOrder
from stkzoo.race.result import read_json, reading
from stkzoo.race.settings import RaceSettings

#: The file of a plan in its batch's folder.
PLAN_FILE = "plan.json"
_MAX_SHOWN = 80
T = TypeVar("T")
Plan = TypeVar("Plan", bound="BatchPlan")


@dataclass(frozen=True, slots=True)
class BatchPlan(ABC):
    """A whole batch, from which its races follow.

    A plan is a dataclass with the ``versions`` of the software, and ``settings`` if its races
    share some.
    """

    #: The ``type`` and ``schema_version`` of the JSON file. The version grows when a plan would
    #: lead to other races.
    kind: ClassVar[str]
    version: ClassVar[int] = 1
    #: What such a batch is called, and the command that resumes one in ``{folder}``.
    noun: ClassVar[str]
    resume_command: ClassVar[str]
    #: Fields of :class:`~stkzoo.race.RaceSettings` that the plan sets for each race.
    decided: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def orders(self) -> Sequence[BatchOrder[Any]]:
        """All races, ready to run."""

    def to_json(self) -> str:
        """The plan as JSON."""
        head = {"type": self.kind, "schema_version": self.version}
        return json.dumps({**head, **self.to_dict()}, indent=2)

    def to_dict(self) -> dict[str, Any]:
        """The plan as JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls: type[Plan], text: str) -> Plan:
        """Reads the output of :meth:`to_json`.

        Raises:
            ConfigError: the text is something else, or has another version.
        """
        with cls._reading():
            values: dict[str, Any] = read_json(text)
            found = values.pop("type"), values.pop("schema_version")
        if found != (cls.kind, cls.version):
            raise ConfigError(
                f"the plan is a {found[0]} of version {found[1]}, expected a {cls.kind} of "
                f"version {cls.version}; resume it with the stkzoo version that started it"
            )
        return cls.from_dict(values)

    @classmethod
    def from_dict(cls: type[Plan], values: Mapping[str, Any]) -> Plan:
        """Reads the output of :meth:`to_dict`.

        Raises:
            ConfigError: the values are no such plan.
        """
        with cls._reading():
            plan = decode(cls, values)
            plan.check()
            return plan

    def check(self) -> None:  # noqa: B027 - not all plans have numbers to check
        """Checks the numbers on which the count of races depends.

        Raises:
            ConfigError: one is out of bounds.
        """

    def differences(self: Plan, other: Plan) -> list[str]:
        """What differs in another plan of the same kind, as sentences."""
        found = describe_differences(self._comparable(), other._comparable())
        for mine, theirs in zip(self._entrants(), other._entrants(), strict=False):
            if changed := mine.changed_files(theirs):
                found.append(f"the files of agent {mine.label!r} have changed: {_shown(changed)}")
        return found

    def _entrants(self) -> tuple[Entrant, ...]:
        return ()

    def _comparable(self) -> dict[str, Any]:
        """The values that decide the races, by name."""
        values = self.to_dict()
        versions, settings = values.pop("versions"), values.pop("settings", {})
        values |= {name: value for name, value in settings.items() if name not in self.decided}
        return values | {"engine": versions.get("pystk2"), "stkzoo": versions.get("stkzoo")}

    @classmethod
    def _reading(cls) -> AbstractContextManager[None]:
        return reading(f"the plan of the {cls.noun} cannot be read", f"a {PLAN_FILE} of stkzoo")


def read_plan(kind: type[Plan], folder: Path) -> Plan:
    """The plan of the batch in a folder.

    Raises:
        ConfigError: there is none, or it cannot be read.
    """
    try:
        return kind.from_json((folder / PLAN_FILE).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{folder} has no {kind.noun} ({error}); expected the --output of one"
        ) from error


def decode(kind: type[T], values: Mapping[str, Any]) -> T:
    """Makes a dataclass of JSON values: lists become tuples, objects become dataclasses.

    Raises:
        TypeError: a value has the wrong type, or is missing.
        KeyError: there is no such field.
    """
    hints = typing.get_type_hints(kind)
    return kind(**{name: _decoded(hints[name], value) for name, value in values.items()})


def _decoded(hint: Any, value: Any) -> Any:
    if isinstance(hint, types.UnionType):
        parts = [part for part in typing.get_args(hint) if part is not types.NoneType]
        return None if value is None else _decoded(parts[0], value)
    if typing.get_origin(hint) is tuple:
        item = typing.get_args(hint)[0]
        return tuple(_decoded(item, entry) for entry in value)
    if isinstance(hint, type) and is_dataclass(hint):
        return decode(hint, value)
    return value


def describe_differences(mine: Mapping[str, Any], theirs: Mapping[str, Any]) -> list[str]:
    """What differs between two plans' values by name, as sentences."""
    return [
        f"{name} is {_shown(theirs.get(name))} and was {_shown(mine.get(name))}"
        for name in sorted(set(mine) | set(theirs))
        if mine.get(name) != theirs.get(name)
    ]


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN else text[:_MAX_SHOWN] + "..."


def choose_settings(
    settings: RaceSettings | None, changes: Mapping[str, Any], decided: Sequence[str]
) -> RaceSettings:
    """The settings of all races of a batch.

    Args:
        settings: the user's settings.
        changes: fields that replace those of ``settings``.
        decided: fields that the plan sets itself.

    Raises:
        ConfigError: a change names no field, or a value is invalid.
    """
    known = {entry.name for entry in fields(RaceSettings)} - set(decided)
    for name in changes:
        if name not in known:
            raise unknown_name("setting of a race", name, known)
    chosen = replace(settings or RaceSettings(), **changes)
    if chosen.error_handling == "raise":
        raise ConfigError(
            "error_handling is 'raise', which would end the batch at the first error; choose "
            "retire, catch or restart"
        )
    if chosen.adapter is not None:
        chosen = replace(chosen, adapter=str(Path(chosen.adapter).resolve()))
    return chosen


def find_tracks(tracks: str | Sequence[str], settings: RaceSettings) -> tuple[str, ...]:
    """The tracks that names and splits stand for, each once.

    Raises:
        ConfigError: there is no such track, or the settings are invalid.
        AssetError: the game's data is missing.
    """
    names = [tracks] if isinstance(tracks, str) else list(tracks)
    if not names:
        raise ConfigError("tracks is empty, expected at least one name")
    known = find_assets().tracks
    shared = ("laps", "difficulty", "reverse", "max_paths")
    options = {name: getattr(settings, name) for name in shared}
    found: dict[str, None] = {}
    for name in names:
        found.update(dict.fromkeys(RaceOptions(num_kart=2, track=name, **options).tracks(known)))
    return tuple(found)


def check_directions(reverse: Sequence[bool]) -> tuple[bool, ...]:
    """The directions to race in: ``False`` is forward, ``True`` is reversed.

    Raises:
        ConfigError: there is none, or one is no direction or listed twice.
    """
    found = tuple(reverse) if isinstance(reverse, Sequence) else (reverse,)
    if not found or len(set(found)) < len(found) or not set(found) <= {False, True}:
        raise ConfigError(
            f"reverse is {reverse!r}, expected (False, True) or one of both: False is forward"
        )
    return tuple(map(bool, found))
