"""A tournament: its plan, checked before the first race, and its result."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from stkzoo.errors import ConfigError, check_whole
from stkzoo.evaluation.batch.entrants import Entrant, find_entrants
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.evaluation.batch.plan import PLAN_FILE, BatchPlan, find_tracks
from stkzoo.evaluation.batch.run import RunOptions, load_batch, run_batch
from stkzoo.evaluation.ratings import rate, require_openskill
from stkzoo.evaluation.statistics import CONFIDENCE
from stkzoo.evaluation.tournament.plot import plot_tournament
from stkzoo.evaluation.tournament.schedule import ScheduledRace, make_schedule
from stkzoo.evaluation.tournament.standings import RaceSummary, Standing
from stkzoo.race.document import Document
from stkzoo.race.result import RaceResult, versions_now
from stkzoo.race.settings import RaceSettings

_MAX_RACES, _MAX_PER_RACE = 100_000, 20
_USUAL_PER_RACE = 4
_MAX_SEED = 2**62


@dataclass(frozen=True, slots=True, kw_only=True)
class TournamentPlan(BatchPlan["TournamentResult"]):
    """A whole tournament, from which its schedule follows.

    Attributes:
        entrants: the agents.
        races: number of races.
        per_race: agents per race.
        seed: of the schedule; race ``i`` has the seed ``seed + i``.
    """

    kind: ClassVar[str] = "tournament-plan"
    noun: ClassVar[str] = "tournament"
    resume_command: ClassVar[str] = "stkzoo tournament --resume {folder}"
    decided: ClassVar[tuple[str, ...]] = ("track", "seed", "show_output")

    entrants: tuple[Entrant, ...]
    races: int
    per_race: int
    seed: int

    def __post_init__(self) -> None:
        check_whole("races", self.races, 1, _MAX_RACES)
        check_whole("seed", self.seed, 0, _MAX_SEED)
        check_whole("per_race", self.per_race, 2, min(len(self.entrants), _MAX_PER_RACE))

    @property
    def agents(self) -> tuple[Entrant, ...]:
        """The agents."""
        return self.entrants

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

    def summarize(self, results: Mapping[int, RaceResult], _: Path) -> TournamentResult:
        """The standings after the races that have been run."""
        races = tuple(RaceSummary.of(number, results[number]) for number in sorted(results))
        number_of = {entrant.label: number for number, entrant in enumerate(self.entrants)}
        orders = [[number_of[label] for label in race.order] for race in races]
        ratings = rate(orders, len(self.entrants), self.seed)
        best_first = sorted(number_of.values(), key=lambda number: -ratings[number].value)
        return TournamentResult(
            plan=self,
            standings=tuple(
                Standing.of(self.entrants[agent], place, ratings[agent], races, results)
                for place, agent in enumerate(best_first, 1)
            ),
            ahead=tuple(
                tuple(
                    sum(one in order and two in order[order.index(one) + 1 :] for order in orders)
                    for two in best_first
                )
                for one in best_first
            ),
            races=races,
        )

    def draw(self, result: TournamentResult, path: Path) -> None:
        """Plots the result into a file."""
        plot_tournament(result, path)

    def require_libraries(self, plot: bool) -> None:
        """Checks that the libraries for the ratings and their plot are installed."""
        require_openskill()
        BatchPlan.require_libraries(self, plot)  # super() fails in slotted dataclasses


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
    chosen = TournamentPlan.choose_settings(settings, changes)
    entrants = find_entrants(agents, chosen)
    return TournamentPlan(
        entrants=entrants,
        tracks=find_tracks(tracks, chosen),
        races=races,
        per_race=min(_USUAL_PER_RACE, len(entrants)) if per_race is None else per_race,
        seed=seed,
        settings=chosen,
    )


@dataclass(frozen=True, slots=True)
class TournamentResult(Document):
    """The result of a tournament.

    Attributes:
        plan: the tournament.
        standings: one per agent, best first.
        ahead: ``ahead[i][j]``: in how many races the agent of ``standings[i]`` finished ahead
            of that of ``standings[j]``.
        races: the races that have been run.
    """

    # docs/schemas/tournament-result.schema.json
    kind: ClassVar[str] = "tournament-result"
    origin: ClassVar[str] = "the --output of `stkzoo tournament`, or its result.json"

    plan: TournamentPlan
    standings: tuple[Standing, ...]
    ahead: tuple[tuple[int, ...], ...]
    races: tuple[RaceSummary, ...]

    @property
    def is_complete(self) -> bool:
        """Whether all races have been run."""
        return len(self.races) == self.plan.races

    @property
    def errors(self) -> int:
        """How often agents failed."""
        return sum(row.errors for row in self.standings)

    def payoff(self, one: int, two: int) -> float | None:
        """The share of their races in which one agent of ``standings`` beat another."""
        won, lost = self.ahead[one][two], self.ahead[two][one]
        return won / (won + lost) if won + lost else None

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON values."""
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


def run_tournament(
    agents: Sequence[str], *, output: str | os.PathLike[str], **options: Any
) -> TournamentResult:
    """Runs a tournament, or resumes it if it was started in ``output``.

    Args:
        agents: the agents; see :func:`~stkzoo.evaluation.plan_tournament`.
        output: a folder of its own, for every race's result and finally ``result.json`` and
            ``tournament.png``.
        options: ``jobs``, ``race_timeout``, ``on_race`` and ``plot``, as in
            :class:`~stkzoo.evaluation.RunOptions`; all others as for
            :func:`~stkzoo.evaluation.plan_tournament`.

    Raises:
        ConfigError: an argument is invalid, a library is missing, or ``output`` has another
            tournament.
        AssetError: the game's data is missing.
        BatchError: some races could not be run.
    """
    run, plan = RunOptions.split(options)
    return run_batch(plan_tournament(agents, **plan), output, run)


def resume_tournament(folder: str | os.PathLike[str], **options: Any) -> TournamentResult:
    """Resumes the tournament that was started in a folder.

    Args:
        folder: the ``output`` of :func:`run_tournament`.
        options: as in :class:`~stkzoo.evaluation.RunOptions`.

    Raises: as :func:`run_tournament`.
    """
    return run_batch(resumed_plan(folder), folder, RunOptions(**options))


def resumed_plan(folder: str | os.PathLike[str]) -> TournamentPlan:
    """The plan of the tournament in a folder, with the present software and agents' files."""
    plan = TournamentPlan.load(Path(folder) / PLAN_FILE)
    entrants = tuple(Entrant.of(entry.label, entry.source) for entry in plan.entrants)
    return replace(plan, entrants=entrants, versions=versions_now())


def load_tournament(path: str | os.PathLike[str]) -> TournamentResult:
    """The result of a tournament so far, without running anything.

    Args:
        path: its folder, or a ``result.json``.

    Raises:
        ConfigError: there is none, it is damaged, or a library is missing.
    """
    return load_batch(TournamentPlan, TournamentResult, path)
