"""The plan of a tournament, checked before the first race."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from stkzoo.errors import ConfigError, check_whole
from stkzoo.evaluation.batch.entrants import Entrant, find_entrants
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.evaluation.batch.plan import BatchPlan, choose_settings, find_tracks
from stkzoo.evaluation.tournament.schedule import ScheduledRace, make_schedule
from stkzoo.race.result import versions_now
from stkzoo.race.settings import RaceSettings

#: Fields of :class:`~stkzoo.race.RaceSettings` that the plan sets for each race.
DECIDED = ("track", "seed")

_MAX_RACES, _MAX_PER_RACE = 100_000, 20
_USUAL_PER_RACE = 4
_MAX_SEED = 2**62


@dataclass(frozen=True, slots=True)
class TournamentPlan(BatchPlan):
    """A whole tournament, from which its schedule follows.

    Attributes:
        entrants: the agents.
        tracks: the tracks.
        races: number of races.
        per_race: agents per race.
        seed: of the schedule; race ``i`` has the seed ``seed + i``.
        settings: of every race; the plan sets ``track`` and ``seed`` itself.
        versions: of the software.
    """

    kind: ClassVar[str] = "tournament-plan"
    noun: ClassVar[str] = "tournament"
    resume_command: ClassVar[str] = "stkzoo tournament --resume {folder}"
    decided: ClassVar[tuple[str, ...]] = DECIDED

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
        """All races, ready to run."""
        return [
            RaceOrder(
                race.number,
                tuple(self.entrants[number].text for number in race.grid),
                replace(self.settings, track=race.track, seed=race.seed),
            )
            for race in self.schedule()
        ]

    def check(self) -> None:
        """Checks the numbers of the schedule."""
        check_whole("races", self.races, 1, _MAX_RACES)
        check_whole("seed", self.seed, 0, _MAX_SEED)
        check_whole("per_race", self.per_race, 2, min(len(self.entrants), _MAX_PER_RACE))

    def _entrants(self) -> tuple[Entrant, ...]:
        return self.entrants

    def _comparable(self) -> dict[str, Any]:
        values = BatchPlan._comparable(self)  # super() fails in slotted dataclasses
        del values["entrants"]
        return values | {"agents": [entrant.text for entrant in self.entrants]}

    def as_of_now(self) -> TournamentPlan:
        """The plan with the present software and agents' files."""
        entrants = tuple(Entrant.of(entry.label, entry.source) for entry in self.entrants)
        return replace(self, entrants=entrants, versions=versions_now())


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
        agents: names of drivers, paths of folders and zips, or modules; append ``@:Name`` to
            rename one.
        tracks: names, or ``"train"``, ``"test"`` or ``"all"``.
        races: number of races.
        per_race: agents per race; by default 4, or all if there are fewer.
        seed: of the schedule; race ``i`` has the seed ``seed + i``.
        settings: of every race.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that replace those of
            ``settings``.

    Raises:
        ConfigError: an argument is invalid, or there is no such agent or track.
        AssetError: the game's data is missing.
    """
    if isinstance(agents, str) or len(agents) < 2:
        raise ConfigError(f"agents is {agents!r}, expected a list of at least two")
    chosen = choose_settings(settings, changes, DECIDED)
    entrants = find_entrants(agents, chosen)
    plan = TournamentPlan(
        entrants=entrants,
        tracks=find_tracks(tracks, chosen),
        races=races,
        per_race=min(_USUAL_PER_RACE, len(entrants)) if per_race is None else per_race,
        seed=seed,
        settings=chosen,
        versions=versions_now(),
    )
    plan.check()
    return plan
