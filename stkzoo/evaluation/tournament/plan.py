"""What a tournament is to be, checked before the first race."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from stkzoo.errors import ConfigError, check_whole
from stkzoo.evaluation.batch import BatchKind, Entrant, RaceOrder, find_entrants
from stkzoo.evaluation.batch.plans import (
    find_tracks,
    read_form,
    settings_of,
    what_changed,
    write_form,
)
from stkzoo.evaluation.tournament.schedule import ScheduledRace, make_schedule
from stkzoo.race.result import versions_now
from stkzoo.race.settings import RaceSettings

__all__ = ["PLAN_VERSION", "TOURNAMENT", "Entrant", "TournamentPlan", "plan_tournament"]

#: Of the JSON form; grows when a plan would lead to other races.
PLAN_VERSION = 1

_KIND = "tournament-plan"
_MAX_RACES, _MAX_PER_RACE = 100_000, 20
_USUAL_PER_RACE = 4
_MAX_SEED = 2**62


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

    def orders(self) -> list[RaceOrder]:
        """All races, as they are to be run."""
        return [
            RaceOrder(
                race.number,
                tuple(self.entrants[number].text for number in race.grid),
                replace(self.settings, track=race.track, seed=race.seed),
            )
            for race in self.schedule()
        ]

    def to_json(self) -> str:
        """The plan as JSON."""
        return write_form(_KIND, PLAN_VERSION, asdict(self) | {"versions": dict(self.versions)})

    @classmethod
    def from_json(cls, text: str) -> TournamentPlan:
        """Reads what :meth:`to_json` wrote.

        Raises:
            ConfigError: it is something else, or of another version.
        """
        form = read_form(text, _KIND, PLAN_VERSION)
        try:
            check_whole("races", form["races"], 1, _MAX_RACES)
            check_whole("seed", form["seed"], 0, _MAX_SEED)
            check_whole("per_race", form["per_race"], 2, len(form["entrants"]))
            return cls(
                **{
                    **form,
                    "entrants": tuple(Entrant(**entry) for entry in form["entrants"]),
                    "tracks": tuple(form["tracks"]),
                    "settings": RaceSettings(**form["settings"]),
                }
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ConfigError(
                f"the plan of the tournament cannot be read ({type(error).__name__}: {error})"
            ) from error

    def differences(self, other: TournamentPlan) -> list[str]:
        """What another plan has otherwise, in words."""
        pairs = zip(self.entrants, other.entrants, strict=False)
        return what_changed(_flat(self), _flat(other), pairs)

    def as_of_now(self) -> TournamentPlan:
        """The plan with the software and the agents' files that are here now.

        Raises:
            ConfigError: an agent's files are there, but no agent any more.
        """
        entrants = tuple(entrant.as_of_now() for entrant in self.entrants)
        return replace(self, entrants=entrants, versions=versions_now())


TOURNAMENT = BatchKind(
    "tournament", TournamentPlan.from_json, "stkzoo tournament --resume {folder}"
)


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
    chosen = settings_of(settings, changes, decided=("track", "seed"))
    entrants = _entrants(agents, chosen)
    check_whole("races", races, 1, _MAX_RACES)
    check_whole("seed", seed, 0, _MAX_SEED)
    most = min(len(entrants), _MAX_PER_RACE)
    per_race = min(_USUAL_PER_RACE, most) if per_race is None else per_race
    check_whole("per_race", per_race, 2, most)
    return TournamentPlan(
        entrants, find_tracks(tracks, chosen), races, per_race, seed, chosen, versions_now()
    )


def _entrants(agents: Sequence[str], settings: RaceSettings) -> tuple[Entrant, ...]:
    if isinstance(agents, str) or len(agents) < 2:
        raise ConfigError(f"agents is {agents!r}, expected a list of at least two")
    return find_entrants(agents, settings)
