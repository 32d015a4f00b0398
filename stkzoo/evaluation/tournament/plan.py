"""The plan of a tournament, which is checked before the first race."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from stkzoo._checks import check_type, check_whole, shortened
from stkzoo._os import write_text
from stkzoo._schema import Whole
from stkzoo.drivers.driver import Driver
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.agents import NAME_MARK, BatchAgent, find_agents, is_among
from stkzoo.evaluation.batch.order import RaceOrder, replay_file
from stkzoo.evaluation.batch.plan import MAX_RACES, PLAN_FILE, BatchPlan, find_tracks
from stkzoo.evaluation.tournament.film import FilmRecorder, film_file
from stkzoo.evaluation.tournament.schedule import (
    ScheduledRace,
    extend_schedule,
    make_schedule,
    newcomer_seats,
)
from stkzoo.race.remote import ServedAgent, ServerAccess
from stkzoo.race.replay import ReplayWriter
from stkzoo.race.result import RaceResult, versions_now
from stkzoo.race.settings import RaceSettings

_MAX_PER_RACE = 20
_MAX_AGENTS = 1000
_USUAL_PER_RACE = 4
_MAX_SEED = 2**62


@dataclass(frozen=True, slots=True)
class TournamentOrder(RaceOrder):
    """One race of a tournament, which can include agents on servers, with its replay and film.

    Attributes:
        served: for each driver, its agent on a server; ``None`` for a driver that runs here.
        access: how to connect to the servers.
    """

    served: tuple[ServedAgent | None, ...] = ()
    access: ServerAccess | None = None

    def run(self, folder: Path) -> RaceResult:
        """Runs the race in a worker process, and stores its replay and film.

        Args:
            folder: folder of the tournament.
        """
        replay, film = replay_file(folder, self.number), film_file(folder, self.number)
        for file in (replay, film):
            file.parent.mkdir(exist_ok=True)
        recorder = FilmRecorder()
        with ExitStack() as resources:
            drivers = self._all_drivers(resources)
            result = self.race(drivers, [recorder, ReplayWriter(replay)])
        write_text(film, recorder.film().to_json())
        return result

    def _all_drivers(self, resources: ExitStack) -> list[str | Driver]:
        """Returns the drivers. Connections to servers are closed with ``resources``."""
        remote = [agent for agent in self.served if agent]
        if not remote:
            return [*self.drivers]
        group = resources.enter_context((self.access or ServerAccess()).connect(remote))
        connected = iter(group.drivers)
        return [
            replace(next(connected), name=text.rpartition(NAME_MARK)[2]) if agent else text
            for text, agent in zip(self.drivers, self.served, strict=True)
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class TournamentPlan(BatchPlan):
    """The plan of a tournament. It determines the schedule.

    Attributes:
        agents: the agents.
        races: number of races among the initial agents.
        per_race: number of agents per race; ``None`` for 4, or all initial agents if fewer.
        seed: seed of the schedule; race ``i`` has the seed ``seed + i``.
        additions: number of agents in each later addition; these agents are the last ones.
        access: how to connect to the servers of agents.
    """

    type_name: ClassVar[str] = "tournament-plan"
    version: ClassVar[int] = 2  # 1: newcomers met some existing agents more often than others
    noun: ClassVar[str] = "tournament"
    resume_command: ClassVar[str] = "stkzoo tournament --resume {folder}"
    decided: ClassVar[tuple[str, ...]] = ("track", "seed")
    changeable: ClassVar[tuple[str, ...]] = ("additions", "access")

    agents: Annotated[tuple[BatchAgent, ...], Meta(min_length=2, max_length=_MAX_AGENTS)]
    races: int
    seed: int
    per_race: int | None = None
    additions: tuple[Whole, ...] = ()
    access: ServerAccess | None = None

    def __post_init__(self) -> None:
        check_whole("races", self.races, 1, MAX_RACES)
        check_whole("seed", self.seed, 0, _MAX_SEED)
        if self.per_race is not None:
            check_whole("per_race", self.per_race, 2, min(self._num_first, _MAX_PER_RACE))
        labels = [agent.label for agent in self.agents]
        if len(set(labels)) < len(labels):
            raise ConfigError(f"two agents have the same label among {shortened(labels)}")

    @property
    def num_races(self) -> int:
        """Total number of races, including those of agents that joined later."""
        return self.races + sum(map(self._races_for, self.additions))

    @property
    def grid_size(self) -> int:
        """Number of agents per race."""
        return self.per_race or min(_USUAL_PER_RACE, self._num_first)

    @property
    def _num_first(self) -> int:
        return len(self.agents) - sum(self.additions)

    def _races_for(self, newcomers: int) -> int:
        """Returns the number of races that give newcomers as many starts as each initial agent."""
        starts = math.ceil(self.races * self.grid_size / self._num_first)
        return math.ceil(starts * newcomers / newcomer_seats(newcomers, self.grid_size))

    def continuing(self, stored: TournamentPlan) -> TournamentPlan:
        """Returns the plan with the stored agents first, in their order; all others join.

        If one of the stored agents is missing, the plan stays as it is.

        Args:
            stored: the plan of the tournament in the folder.
        """
        requested = {agent.text: agent for agent in self.agents}
        if not {agent.text for agent in stored.agents} <= requested.keys():
            return self
        first = tuple(requested.pop(agent.text) for agent in stored.agents)
        return replace(
            self,
            agents=(*first, *requested.values()),
            additions=(*stored.additions, len(requested)) if requested else stored.additions,
            access=self.access or stored.access,
        )

    def orders(self) -> list[TournamentOrder]:
        """Returns the orders of all races."""
        return [
            TournamentOrder(
                race.number,
                tuple(agent.text for agent in grid),
                replace(self.settings, track=race.track, seed=race.seed),
                served=tuple(agent.served for agent in grid),
                access=self.access,
            )
            for race in self.schedule()
            for grid in [[self.agents[number] for number in race.grid]]
        ]

    def schedule(self) -> tuple[ScheduledRace, ...]:
        """Returns all races, in order."""
        known = self._num_first
        races = make_schedule(known, self.tracks, self.races, self.grid_size, self.seed)
        for count in self.additions:
            races += extend_schedule(races, known, count, self._races_for(count), self.seed)
            known += count
        return races


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
    check_type("agents", agents, Sequence, "a list of at least two")
    if (count := len(agents) + len(served)) < 2:
        raise ConfigError(
            f"a tournament needs at least two agents, such as my_agent and ai; this one has {count}"
        )
    chosen = TournamentPlan.settings_of(settings, changes)
    entered = find_agents(agents, chosen, served)
    return TournamentPlan(
        agents=entered,
        tracks=find_tracks(tracks, chosen),
        races=races,
        per_race=per_race,
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


def resumed_plan(
    folder: str | os.PathLike[str],
    agents: Sequence[str] = (),
    servers: ServerAccess | None = None,
) -> TournamentPlan:
    """Returns the plan of a tournament with the current versions of software and agents' files.

    Args:
        folder: folder of the tournament.
        agents: agents that join the tournament, unless they have already joined it.
        servers: servers whose agents join the tournament, unless they have already joined it.

    Raises:
        ConfigError: there is no plan, or an agent is invalid.
        RemoteError: a server does not answer.
    """
    plan = TournamentPlan.load(Path(folder) / PLAN_FILE)
    known = tuple(agent.now() for agent in plan.agents)
    served, access = ask_servers(servers)
    here = {agent.served for agent in known}
    new = find_agents(
        [text for text in agents if not is_among(text, known)],
        plan.settings,
        [agent for agent in served if agent not in here],
        [agent.label for agent in known],
    )
    return replace(
        plan, agents=(*known, *new), access=access or plan.access, versions=versions_now()
    )
