"""The plan of a tournament, which is checked before the first race, and its result."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from stkzoo._schema import Count, Whole
from stkzoo.errors import ConfigError, check_whole, shortened
from stkzoo.evaluation.batch.entrants import Entrant, find_entrants
from stkzoo.evaluation.batch.plan import (
    MAX_RACES,
    MAX_RESULT_BYTES,
    BatchPlan,
    find_tracks,
)
from stkzoo.evaluation.ratings import rate, require_openskill
from stkzoo.evaluation.statistics import CONFIDENCE
from stkzoo.evaluation.tournament.order import TournamentOrder
from stkzoo.evaluation.tournament.plot import plot_tournament
from stkzoo.evaluation.tournament.report import TournamentReport
from stkzoo.evaluation.tournament.schedule import (
    ScheduledRace,
    extend_schedule,
    make_schedule,
    newcomer_seats,
)
from stkzoo.evaluation.tournament.standings import RaceSummary, Standing
from stkzoo.race.document import Document
from stkzoo.race.remote import ServedAgent, ServerAccess
from stkzoo.race.result import RaceResult, shared_protections
from stkzoo.race.settings import RaceSettings

_MAX_PER_RACE = 20
_MAX_ENTRANTS = 1000
_USUAL_PER_RACE = 4
_MAX_SEED = 2**62


@dataclass(frozen=True, slots=True, kw_only=True)
class TournamentPlan(BatchPlan["TournamentResult"]):
    """The plan of a tournament. It determines the schedule.

    Attributes:
        entrants: the agents.
        races: number of races among the initial agents.
        per_race: number of agents per race.
        seed: seed of the schedule; race ``i`` has the seed ``seed + i``.
        additions: number of agents in each later addition; these agents are the last entrants.
        access: how to connect to the servers of agents.
    """

    kind: ClassVar[str] = "tournament-plan"
    version: ClassVar[int] = 2  # 1: newcomers met some existing agents more often than others
    noun: ClassVar[str] = "tournament"
    resume_command: ClassVar[str] = "stkzoo tournament --resume {folder}"
    decided: ClassVar[tuple[str, ...]] = ("track", "seed")

    entrants: Annotated[tuple[Entrant, ...], Meta(min_length=2, max_length=_MAX_ENTRANTS)]
    races: int
    per_race: int
    seed: int
    additions: tuple[Whole, ...] = ()
    access: ServerAccess | None = None

    def __post_init__(self) -> None:
        check_whole("races", self.races, 1, MAX_RACES)
        check_whole("seed", self.seed, 0, _MAX_SEED)
        check_whole("per_race", self.per_race, 2, min(self._num_first, _MAX_PER_RACE))
        labels = [entrant.label for entrant in self.entrants]
        if len(set(labels)) < len(labels):
            raise ConfigError(f"two entrants have the same label among {shortened(labels)}")

    @property
    def agents(self) -> tuple[Entrant, ...]:
        """The agents."""
        return self.entrants

    @property
    def num_races(self) -> int:
        """Total number of races, including those of agents that joined later."""
        return self.races + sum(map(self._races_for, self.additions))

    @property
    def _num_first(self) -> int:
        return len(self.entrants) - sum(self.additions)

    def _races_for(self, newcomers: int) -> int:
        """Returns the number of races that give newcomers as many starts as each initial agent."""
        starts = math.ceil(self.races * self.per_race / self._num_first)
        return math.ceil(starts * newcomers / newcomer_seats(newcomers, self.per_race))

    def schedule(self) -> tuple[ScheduledRace, ...]:
        """Returns all races, in order."""
        known = self._num_first
        races = make_schedule(known, self.tracks, self.races, self.per_race, self.seed)
        for count in self.additions:
            races += extend_schedule(races, known, count, self._races_for(count), self.seed)
            known += count
        return races

    def moved(self, folder: Path) -> TournamentPlan:
        """See :meth:`BatchPlan.moved`."""
        return replace(self, entrants=tuple(entry.moved(folder) for entry in self.entrants))

    def continued(self, other: TournamentPlan) -> TournamentPlan:
        """Returns this plan, extended by the agents that only another plan has.

        Args:
            other: the other plan. It must include all agents of this plan; otherwise none is added.
        """
        own, asked = ({entry.text for entry in plan.entrants} for plan in (self, other))
        new = tuple(entry for entry in other.entrants if entry.text not in own)
        kept = replace(self, access=other.access or self.access)
        if not new or not own <= asked:
            return kept
        return replace(kept, entrants=(*self.entrants, *new), additions=(*self.additions, len(new)))

    def differences(self, other: TournamentPlan) -> list[str]:
        """Describes how another plan differs. The order of agents does not matter after additions.

        Args:
            other: the other plan.

        Returns:
            One sentence per difference.
        """
        if self.additions:
            place = {entry.text: number for number, entry in enumerate(self.entrants)}
            last = len(place)
            in_order = sorted(other.entrants, key=lambda entry: place.get(entry.text, last))
            other = replace(other, entrants=tuple(in_order), additions=())
        return BatchPlan.differences(self, other)

    def _comparable(self) -> dict[str, Any]:
        values = BatchPlan._comparable(self)
        return {name: values[name] for name in values if name not in ("additions", "access")}

    def orders(self) -> list[TournamentOrder]:
        """Returns the orders of all races."""
        return [
            TournamentOrder(
                race.number,
                tuple(entrant.text for entrant in grid),
                replace(self.settings, track=race.track, seed=race.seed),
                served=tuple(entrant.served for entrant in grid),
                access=self.access,
            )
            for race in self.schedule()
            for grid in [[self.entrants[number] for number in race.grid]]
        ]

    def summarize(self, results: Mapping[int, RaceResult], _: Path) -> TournamentResult:
        """Returns the result after the races that have been run.

        Args:
            results: results of races by number.
        """
        races = tuple(RaceSummary.of(number, results[number]) for number in sorted(results))
        number_of = {entrant.label: number for number, entrant in enumerate(self.entrants)}
        orders = [[number_of[label] for label in race.order] for race in races]
        places = [[race.place_of(label) for label in race.order] for race in races]
        ratings = rate(orders, len(self.entrants), self.seed, places)
        place_in = [dict(zip(*race, strict=True)) for race in zip(orders, places, strict=True)]
        sandboxes, protections = shared_protections(results.values())
        best_first = sorted(number_of.values(), key=lambda number: -ratings[number].value)
        return TournamentResult(
            plan=self,
            standings=tuple(
                Standing.of(self.entrants[agent], place, ratings[agent], races, results)
                for place, agent in enumerate(best_first, 1)
            ),
            ahead=tuple(
                tuple(
                    sum(
                        {one, two} <= place.keys() and place[one] < place[two] for place in place_in
                    )
                    for two in best_first
                )
                for one in best_first
            ),
            races=races,
            sandboxes=sandboxes,
            protections=protections,
        )

    def draw(self, result: TournamentResult, path: Path) -> None:
        """Plots the result to a file."""
        plot_tournament(result, path)

    def report(
        self, result: TournamentResult, results: Mapping[int, RaceResult], folder: Path
    ) -> None:
        """Writes the page and tables of the report."""
        TournamentReport(folder, result, results).write(folder)

    def require_libraries(self, plot: bool) -> None:
        """Checks that the libraries for the ratings and their plot are installed."""
        require_openskill()
        BatchPlan.require_libraries(self, plot)  # super() fails in slotted dataclasses


def plan_tournament(
    agents: Sequence[str] = (),
    *,
    servers: ServerAccess | None = None,
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
        servers: servers whose agents also take part.
        tracks: names of tracks or of splits (:data:`stkzoo.tracks.SPLITS`).
        races: number of races.
        per_race: number of agents per race; by default 4, or all if there are fewer.
        seed: seed of the schedule; race ``i`` has the seed ``seed + i``.
        settings: settings of every race.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that replace those of
            ``settings``.

    Raises:
        ConfigError: an argument is invalid, or an agent or track does not exist.
        RemoteError: a server does not answer.
        AssetError: the game's data is missing.
    """
    served, access = ask_servers(servers)
    if isinstance(agents, str):
        raise ConfigError(f"agents is {shortened(agents, 80)}, expected a list of at least two")
    if (count := len(agents) + len(served)) < 2:
        raise ConfigError(
            f"a tournament needs at least two agents, such as my_agent and ai; this one has {count}"
        )
    chosen = TournamentPlan.choose_settings(settings, changes)
    entrants = find_entrants(agents, chosen, served)
    return TournamentPlan(
        entrants=entrants,
        tracks=find_tracks(tracks, chosen),
        races=races,
        per_race=min(_USUAL_PER_RACE, len(entrants)) if per_race is None else per_race,
        seed=seed,
        settings=chosen,
        access=access,
    )


def ask_servers(servers: ServerAccess | None) -> tuple[list[ServedAgent], ServerAccess | None]:
    """Returns the agents of servers, and the access without addresses, which the agents store.

    Args:
        servers: how to connect to them; ``None`` for no servers.

    Raises:
        RemoteError: a server does not answer.
    """
    if servers is None:
        return [], None
    with servers.connect() as group:
        return group.agents, replace(servers, servers=(), server_keys=())


@dataclass(frozen=True, slots=True)
class TournamentResult(Document):
    """The result of a tournament.

    Attributes:
        plan: the tournament.
        standings: standings of the agents, best first.
        ahead: ``ahead[i][j]`` is the number of races in which the agent of ``standings[i]``
            finished ahead of the agent of ``standings[j]``. Two retired agents are tied.
        races: the races that have been run.
        sandboxes: sandboxes of the agents from files in these races.
        protections: protections that applied in all races with agents from files
            (:func:`stkzoo.drivers.sandbox.protections`).
    """

    # docs/schemas/tournament-result.schema.json
    kind: ClassVar[str] = "tournament-result"
    origin: ClassVar[str] = "the --output of `stkzoo tournament`, or its result.json"
    max_bytes: ClassVar[int] = MAX_RESULT_BYTES

    plan: TournamentPlan
    standings: tuple[Standing, ...]
    ahead: tuple[tuple[Count, ...], ...]
    races: tuple[RaceSummary, ...]
    sandboxes: tuple[str, ...] = field(compare=False, default=())
    protections: tuple[str, ...] = field(compare=False, default=())

    def __post_init__(self) -> None:
        count = len(self.plan.entrants)
        if [len(self.standings), *map(len, self.ahead)] != [count] * (1 + count):
            raise ConfigError(
                f"standings and ahead have {len(self.standings)} and {len(self.ahead)} agents, "
                f"expected {count} each"
            )

    @property
    def is_complete(self) -> bool:
        """Whether all races have been run."""
        return len(self.races) == self.plan.num_races

    @property
    def errors(self) -> int:
        """Total number of failures of agents."""
        return sum(row.errors for row in self.standings)

    def payoff(self, one: int, two: int) -> float | None:
        """Returns the fraction of their shared races in which one agent beat another.

        Args:
            one: index of the first agent in ``standings``.
            two: index of the second agent in ``standings``.

        Returns:
            The fraction of races that the first agent won; ``None`` if neither was ahead in any.
        """
        won, lost = self.ahead[one][two], self.ahead[two][one]
        return won / (won + lost) if won + lost else None

    def to_dict(self) -> dict[str, Any]:
        """Returns the result as JSON values."""
        everybody = range(len(self.standings))
        rating_model = {
            "name": "plackett-luce",
            "interval": "bootstrap over races",
            "confidence": CONFIDENCE,
        }
        return {
            "is_complete": self.is_complete,
            "rating_model": rating_model,
            **Document.to_dict(self),
            "payoff": [[self.payoff(one, two) for two in everybody] for one in everybody],
        }
