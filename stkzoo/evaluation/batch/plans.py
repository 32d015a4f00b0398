"""What the plans of all batches have in common: how they are checked, kept and compared."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from stkzoo.engine.assets import find_assets
from stkzoo.env.options import RaceOptions
from stkzoo.errors import ConfigError, unknown_name
from stkzoo.evaluation.batch.entrant import Entrant
from stkzoo.race.result import read_json
from stkzoo.race.settings import RaceSettings

__all__ = [
    "find_tracks",
    "read_form",
    "settings_of",
    "shown",
    "what_changed",
    "write_form",
]

_MAX_SHOWN = 80


def settings_of(
    settings: RaceSettings | None, changes: Mapping[str, Any], decided: Iterable[str]
) -> RaceSettings:
    """The settings of all races of a batch.

    Args:
        settings: as they were given.
        changes: fields that are other than in ``settings``.
        decided: fields that the batch decides itself.

    Raises:
        ConfigError: a change is of no field, or a value cannot be.
    """
    known = {entry.name for entry in fields(RaceSettings)} - set(decided)
    for name in changes:
        if name not in known:
            raise unknown_name("setting of a race", name, known)
    chosen = replace(settings or RaceSettings(), **changes)
    if chosen.error_handling == "raise":
        raise ConfigError(
            "error_handling is 'raise', which would end all at the first error; choose retire, "
            "catch or restart"
        )
    if chosen.adapter is not None:
        chosen = replace(chosen, adapter=str(Path(chosen.adapter).resolve()))
    return chosen


def find_tracks(tracks: str | Sequence[str], settings: RaceSettings) -> tuple[str, ...]:
    """The tracks that names and splits stand for, each once.

    Raises:
        ConfigError: there is no such track, or the settings cannot be.
        AssetError: the game's data is missing.
    """
    names = [tracks] if isinstance(tracks, str) else list(tracks)
    if not names:
        raise ConfigError("tracks is empty, expected at least one name")
    known = find_assets().tracks
    found: dict[str, None] = {}
    for name in names:
        options = RaceOptions(
            num_kart=2,
            track=name,
            laps=settings.laps,
            difficulty=settings.difficulty,
            reverse=settings.reverse,
            max_paths=settings.max_paths,
        )
        found.update(dict.fromkeys(options.tracks(known)))
    return tuple(found)


def write_form(kind: str, version: int, form: Mapping[str, Any]) -> str:
    """A plan as JSON."""
    return json.dumps({"type": kind, "schema_version": version, **form}, indent=2)


def read_form(text: str, kind: str, version: int) -> dict[str, Any]:
    """What was given to :func:`write_form`.

    Raises:
        ConfigError: it is something else, or of another version.
    """
    try:
        form: dict[str, Any] = read_json(text)
        found = form.pop("type"), form.pop("schema_version")
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        raise ConfigError(f"the {kind} cannot be read ({type(error).__name__}: {error})") from error
    if found != (kind, version):
        raise ConfigError(
            f"the plan is a {found[0]} of version {found[1]}, expected a {kind} of version "
            f"{version}; go on with the stkzoo that began it"
        )
    return form


def what_changed(
    mine: Mapping[str, Any],
    theirs: Mapping[str, Any],
    agents: Iterable[tuple[Entrant, Entrant]],
) -> list[str]:
    """What another plan has otherwise, in words.

    Args:
        mine: a plan's values by name.
        theirs: the other's.
        agents: agents of this plan, each with the other plan's in its place.
    """
    found = [
        f"{name} is {shown(theirs.get(name))} and was {shown(mine.get(name))}"
        for name in sorted(set(mine) | set(theirs))
        if mine.get(name) != theirs.get(name)
    ]
    for one, two in agents:
        if changed := one.changed_files(two):
            found.append(f"the files of agent {one.label!r} are others: {shown(changed)}")
    return found


def shown(value: object) -> str:
    """A value, cut to a length that can be read."""
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN else text[:_MAX_SHOWN] + "..."
