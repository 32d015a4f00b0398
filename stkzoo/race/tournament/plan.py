"""What a tournament is to be, checked before the first race."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path, PurePath
from typing import Any

from stkzoo.engine.assets import find_assets
from stkzoo.env.options import RaceOptions
from stkzoo.errors import ConfigError, unknown_name
from stkzoo.race.drivers import driver_names, find_driver
from stkzoo.race.result import versions_now
from stkzoo.race.settings import RaceSettings
from stkzoo.race.tournament.fingerprint import fingerprint
from stkzoo.race.tournament.schedule import ScheduledRace, make_schedule

__all__ = ["PLAN_VERSION", "Entrant", "TournamentPlan", "plan_tournament"]

#: Of the JSON form; grows when a plan would lead to other races.
PLAN_VERSION = 1

_NAME_MARK = "@:"
_MAX_RACES, _MAX_PER_RACE = 100_000, 20
_USUAL_PER_RACE = 4
_MAX_SEED = 2**62
_MAX_SHOWN = 80


@dataclass(frozen=True, slots=True)
class Entrant:
    """An agent that takes part.

    Attributes:
        label: what it is called; nobody else is.
        source: its name or where its files are, for :func:`~stkzoo.race.find_driver`.
        files: a digest of each of its files, by path.
    """

    label: str
    source: str
    files: Mapping[str, str] = field(default_factory=dict, hash=False)

    @classmethod
    def of(cls, label: str, source: str) -> Entrant:
        """An agent with its files as they are now."""
        return cls(label, source, fingerprint(source))

    @property
    def text(self) -> str:
        """The driver's text for a race."""
        return f"{self.source}{_NAME_MARK}{self.label}"


@dataclass(frozen=True, slots=True)
class TournamentPlan:
    """A whole tournament, from which its schedule follows.

    Attributes:
        entrants: who takes part.
        tracks: where.
        races: how many races.
        per_race: how many agents in each.
        seed: decides the schedule, and the races' own seeds.
        settings: of every race; ``track`` and ``seed`` in it do not count.
        versions: of the software.
    """

    entrants: tuple[Entrant, ...]
    tracks: tuple[str, ...]
    races: int
    per_race: int
    seed: int
    settings: RaceSettings
    versions: Mapping[str, str]

    def schedule(self) -> tuple[ScheduledRace, ...]:
        """All races."""
        return make_schedule(len(self.entrants), self.tracks, self.races, self.per_race, self.seed)

    def to_json(self) -> str:
        """The plan as JSON."""
        form = asdict(self) | {"versions": dict(self.versions)}
        return json.dumps(
            {"type": "tournament-plan", "schema_version": PLAN_VERSION, **form}, indent=2
        )

    @classmethod
    def from_json(cls, text: str) -> TournamentPlan:
        """Reads what :meth:`to_json` wrote.

        Raises:
            ConfigError: it is something else, or of another version.
        """
        try:
            form = json.loads(text)
            found = form.pop("type"), form.pop("schema_version")
            if found != ("tournament-plan", PLAN_VERSION):
                raise ConfigError(
                    f"the plan is a {found[0]} of version {found[1]}, expected a tournament-plan "
                    f"of version {PLAN_VERSION}; go on with the stkzoo that began it"
                )
            return cls(
                **{
                    **form,
                    "entrants": tuple(Entrant(**entry) for entry in form["entrants"]),
                    "tracks": tuple(form["tracks"]),
                    "settings": RaceSettings(**form["settings"]),
                }
            )
        except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
            raise ConfigError(
                f"the plan of the tournament cannot be read ({type(error).__name__}: {error})"
            ) from error

    def differences(self, other: TournamentPlan) -> list[str]:
        """What another plan has otherwise, in words."""
        mine, theirs = _flat(self), _flat(other)
        found = [
            f"{name} is {_shown(theirs.get(name))} and was {_shown(mine.get(name))}"
            for name in sorted(set(mine) | set(theirs))
            if mine.get(name) != theirs.get(name)
        ]
        for one, two in zip(self.entrants, other.entrants, strict=False):
            changed = [name for name, sum_ in one.files.items() if two.files.get(name) != sum_]
            if changed and one.text == two.text:
                found.append(f"the files of agent {one.label!r} are others: {_shown(changed)}")
        return found

    def as_of_now(self) -> TournamentPlan:
        """The plan with the software and the agents' files that are here now.

        Raises:
            ConfigError: an agent's files are there, but no agent any more.
        """
        entrants = tuple(Entrant.of(entrant.label, entrant.source) for entrant in self.entrants)
        return replace(self, entrants=entrants, versions=versions_now())


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN else text[:_MAX_SHOWN] + "..."


def _flat(plan: TournamentPlan) -> dict[str, Any]:
    settings = {k: v for k, v in asdict(plan.settings).items() if k not in ("track", "seed")}
    return settings | {
        "agents": [entrant.text for entrant in plan.entrants],
        "tracks": list(plan.tracks),
        "races": plan.races,
        "per_race": plan.per_race,
        "seed": plan.seed,
        "engine": plan.versions.get("pystk2"),
        "stkzoo": plan.versions.get("stkzoo"),
    }


def plan_tournament(
    agents: Sequence[str],
    *,
    tracks: str | Sequence[str] = "train",
    races: int = 60,
    per_race: int | None = None,
    seed: int = 0,
    settings: RaceSettings | None = None,
    **changes: Any,
) -> TournamentPlan:
    """Plans a tournament.

    Args:
        agents: who takes part: names of drivers, paths of folders and zips, modules, with
            ``@:Name`` behind them to call them something else.
        tracks: names, or ``"train"``, ``"test"`` or ``"all"``.
        races: how many races.
        per_race: how many agents in each; by default 4, or all if they are fewer.
        seed: decides the schedule; race ``i`` has the seed ``seed + i``.
        settings: of every race.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that are other than in
            ``settings``.

    Raises:
        ConfigError: an argument cannot be, or there is no such agent or track.
        AssetError: the game's data is missing.
    """
    chosen = _settings(settings, changes)
    entrants = _entrants(agents, chosen)
    _check_whole("races", races, 1, _MAX_RACES)
    _check_whole("seed", seed, 0, _MAX_SEED)
    most = min(len(entrants), _MAX_PER_RACE)
    per_race = min(_USUAL_PER_RACE, most) if per_race is None else per_race
    _check_whole("per_race", per_race, 2, most)
    return TournamentPlan(
        entrants, _tracks(tracks, chosen), races, per_race, seed, chosen, versions_now()
    )


def _settings(settings: RaceSettings | None, changes: Mapping[str, Any]) -> RaceSettings:
    known = {entry.name for entry in fields(RaceSettings)} - {"track", "seed"}
    for name in changes:
        if name not in known:
            raise unknown_name("setting of a race", name, known)
    chosen = replace(settings or RaceSettings(), **changes)
    if chosen.error_handling == "raise":
        raise ConfigError(
            "error_handling is 'raise', which would end the tournament at the first error; "
            "choose retire, catch or restart"
        )
    if chosen.adapter is not None:
        chosen = replace(chosen, adapter=str(Path(chosen.adapter).resolve()))
    return chosen


def _tracks(tracks: str | Sequence[str], settings: RaceSettings) -> tuple[str, ...]:
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


def _entrants(agents: Sequence[str], settings: RaceSettings) -> tuple[Entrant, ...]:
    if isinstance(agents, str) or len(agents) < 2:
        raise ConfigError(f"agents is {agents!r}, expected a list of at least two")
    sources, names = [], []
    for text in agents:
        driver = find_driver(text, inline=settings.inline, adapter=settings.adapter)
        named = text.rpartition(_NAME_MARK)[2] if _NAME_MARK in text else ""
        sources.append(_lasting(driver.source))
        names.append(named or _short(driver.source))
    counts = Counter(names)
    labels = [
        name if counts[name] == 1 else (text.rpartition(_NAME_MARK)[2] or text)
        for name, text in zip(names, agents, strict=True)
    ]
    for label, count in Counter(labels).items():
        if count > 1:
            raise ConfigError(
                f"{count} agents are called {label!r}; give each a name of its own, such as "
                f"{agents[labels.index(label)].partition(_NAME_MARK)[0]}@:{label}-2"
            )
    return tuple(map(Entrant.of, labels, sources))


def _lasting(source: str) -> str:
    """The source such that it is found from everywhere."""
    path = Path(source).expanduser()
    return str(path.resolve()) if source not in driver_names() and path.exists() else source


def _short(source: str) -> str:
    path = PurePath(source)
    return (path.stem if path.suffix in (".zip", ".py") else path.name) or source


def _check_whole(name: str, value: object, low: int, high: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ConfigError(f"{name} is {value!r}, expected a whole number from {low} to {high}")
